#include "termination.hpp"

#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstring>
#include <memory>
#include <semaphore>
#include <string>
#include <system_error>
#include <thread>

#include "rcs/device.hpp"

namespace rcs {

namespace {

constexpr std::array kSignals{SIGTERM, SIGHUP};
// How long devices may take to hold. The sender of a signal does not wait for long.
constexpr std::chrono::seconds kLongest{1};

sem_t g_told;  // a handler may do little more than post it
std::atomic<int> g_signal = 0;
std::atomic<pid_t> g_process = 0;  // in which the thread waits: a child made by `fork` has none of these devices

void on_signal(int number) {
  if (g_process != getpid()) {
    raise(number);  // ends the child when this returns
    return;
  }
  g_signal = number;
  sem_post(&g_told);
}

// A handler that runs on the main thread of Python would wait for the interpreter; a thread of its own does not.
void wait_for_signal() {
  pthread_setname_np(pthread_self(), "rcs termination");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
  while (sem_wait(&g_told) != 0) {
  }
  const int number = g_signal;
  const auto held = std::make_shared<std::binary_semaphore>(0);
  const auto stop = [number, held] {
    stop_all(std::string("a signal ended the program (") + strsignal(number) + ")");
    held->release();
  };
  try {
    std::thread(stop).detach();
  } catch (const std::system_error&) {
    stop();  // no thread can be started
  }
  static_cast<void>(held->try_acquire_for(kLongest));
  kill(getpid(), number);
}

}  // namespace

void hold_at_termination() {
  if (g_process.exchange(getpid()) != getpid()) {
    g_signal = 0;  // that of a parent
    sem_init(&g_told, 0, 0);
    std::thread(wait_for_signal).detach();
  }
  if (g_signal != 0) return;  // it is about to be sent again, and is to end the process
  for (const int number : kSignals) {
    struct sigaction now{};
    struct sigaction ours{};
    sigaction(number, nullptr, &now);
    if ((now.sa_flags & SA_SIGINFO) != 0 || now.sa_handler != SIG_DFL) continue;
    ours.sa_handler = on_signal;
    ours.sa_flags = SA_RESTART | static_cast<int>(SA_RESETHAND);  // the second one ends the process
    sigaction(number, &ours, nullptr);
  }
}

}  // namespace rcs
