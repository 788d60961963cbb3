// The memory that a program shares with the host of one device, and how one waits for the other. Private to the
// sources.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <thread>
#include <type_traits>

#include "rcs/hosted.hpp"

namespace rcs {

inline constexpr std::size_t kHostValues = 32;  // joints of an arm or a hand

/// A text of limited length that lies in shared memory.
template <std::size_t Size>
struct HostText {
  std::array<char, Size> characters;

  void set(const std::string& text) {
    characters.fill('\0');
    std::size_t size = std::min(text.size(), Size - 1);
    // Not in the middle of a character of UTF-8: the rest of it is no text.
    while (size > 0 && size < text.size() && (static_cast<unsigned char>(text[size]) & 0xC0) == 0x80) --size;
    text.copy(characters.data(), size);
  }
  std::string get() const { return {characters.data(), strnlen(characters.data(), Size)}; }
};

/// A value that one side writes and the other reads, without a lock: the reader looks again when it changed meanwhile.
template <typename T>
class Guarded {
 public:
  static_assert(std::is_trivially_copyable_v<T>);

  void write(const T& value) {
    const std::uint32_t number = number_.load(std::memory_order_relaxed);
    number_.store(number + 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    std::memcpy(&value_, &value, sizeof(T));
    number_.store(number + 2, std::memory_order_release);
  }
  /// False when the writer ended in the middle of writing. One that other threads keep from running is waited for.
  bool read(T& value) const {
    double limit = kNaN;
    for (int tries = 0;; ++tries) {
      const std::uint32_t number = number_.load(std::memory_order_acquire);
      if (number % 2 == 0) {
        std::memcpy(&value, &value_, sizeof(T));
        std::atomic_thread_fence(std::memory_order_acquire);
        if (number_.load(std::memory_order_relaxed) == number) return true;
      }
      if (tries < kQuickTries) continue;
      const double now = monotonic_time();
      if (std::isnan(limit)) limit = now + kWriting;
      if (now > limit) return false;
      std::this_thread::sleep_for(std::chrono::microseconds(20));
    }
  }

 private:
  static constexpr int kQuickTries = 1000;
  /// Longest time in which a value is written [s].
  static constexpr double kWriting = 0.5;

  std::atomic<std::uint32_t> number_;
  T value_;
};

struct HostAsked {
  std::uint32_t number;
  std::uint32_t stops;  // of the program, when it asked
  HostCall call;
  std::int32_t count;
  std::array<double, kHostValues> values;
  double force;              // NaN for none
  double period;             // s, between commands to a streamed arm; 0 for the usual one
  std::int64_t valid_until;  // ns
};

struct HostAnswer {
  std::uint32_t number;
  HostOutcome outcome;
  std::int32_t flag;
  HostText<512> text;
};

struct HostMeasured {
  std::array<std::int32_t, 5> counts;
  std::array<std::array<double, kHostValues>, 5> values;
  double opening, force, time, device_time;
  Clamped clamped;  // of a streamed arm
  HostText<64> mode;
  HostText<512> failure;  // why there is nothing newer, or empty
};

/// All zero at the beginning. The numbers that are waited for are those of the kernel's futex. A change of these
/// structures counts in `kInterfaceVersion`, which hosts tell programs.
struct HostMemory {
  // The program writes these.
  std::atomic<std::int64_t> sign_of_program;  // ns, when it last showed that it runs
  std::atomic<std::uint32_t> asked, hold_asked, stops;
  Guarded<HostAsked> request;
  // The host writes these.
  std::atomic<std::int64_t> next_sign;  // ns, until when it shows again that it runs
  std::atomic<std::uint32_t> done, held, changes_of_fault;
  Guarded<HostAnswer> answer, refusal;  // the last one, and the last that was not done
  Guarded<HostMeasured> measured;
  Guarded<HostText<64>> under_way;
  Guarded<HostText<512>> fault, hold_failure;
};
static_assert(std::atomic<std::uint32_t>::is_always_lock_free && std::atomic<std::int64_t>::is_always_lock_free);

/// Now, on the clock that all processes of a machine share [ns].
std::int64_t host_clock();
/// Map the memory. Throws `InvalidSetup` when it has another size.
HostMemory* map_host_memory(int file);
void unmap_host_memory(HostMemory* memory);
/// Wait until a number is no longer `value`, or for a time [s]; may return early.
void await_change(const std::atomic<std::uint32_t>& number, std::uint32_t value, double seconds);
void wake_all(std::atomic<std::uint32_t>& number);
/// Whether the other side of a socket, or a process, is gone.
bool is_gone(int socket, int process_file);
/// A file that is readable when the process has ended, or -1.
int open_process(int process);

/// Whether a time to come has passed for good: two looks in a row, so that a machine that stood still is no finding.
class Overdue {
 public:
  bool look(std::int64_t due) {
    const bool is_late = due != 0 && host_clock() > due;
    looks_ = is_late ? looks_ + 1 : 0;
    return looks_ >= 2;
  }

 private:
  int looks_ = 0;
};

}  // namespace rcs
