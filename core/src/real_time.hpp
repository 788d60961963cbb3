// Real-time priority and locked memory of an arm's thread, and what to change where the system refuses them.
#pragma once

#include <pthread.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include <atomic>
#include <csignal>
#include <string>

namespace rcs {

// Above what interrupts of a real-time kernel have, 50; the kernel's own watchdogs are at 99.
inline constexpr int kPriority = 80;

/// Whether a thread runs in real time. `advice` may be called by other threads.
class RealTime {
 public:
  /// Request it for the calling thread, which gets a name and no signals.
  void request() {
    pthread_setname_np(pthread_self(), "rcs arm");
    sigset_t all;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the threads of the program
    const sched_param priority{kPriority};
    has_priority = pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority) == 0;
    // Under a limit, locking what is to come would make later allocations of the program fail.
    rlimit limit{};
    has_locked = getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY &&
                 mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0;
  }

  /// The reason why the thread does not run in real time, and the line that mends it; empty when there is none.
  std::string advice() const {
    const bool priority = has_priority, locked = has_locked;
    if (priority && locked) return "";
    std::string text;
    if (!priority) text += "the arm's thread has no real-time priority, so that ticks come late on a busy machine";
    if (!locked)
      text +=
          std::string(priority ? "" : "; ") + "its memory is not locked, so that ticks come late where memory is short";
    return text + "; add the lines '@realtime - rtprio 99' and '@realtime - memlock unlimited' to " +
           "/etc/security/limits.conf, add yourself to the group realtime, and log in anew";
  }

  void forget() { has_priority = has_locked = false; }

 private:
  std::atomic<bool> has_priority = false, has_locked = false;
};

}  // namespace rcs
