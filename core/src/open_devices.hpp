// The open devices of this process, and the thread that has them held when a command's time is over. Private to the
// sources.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// One per process: a child made by `fork` starts with none, for its parent has the connections.
///
/// Its lock is never held while a device is called. It is never destroyed, as the thread runs to the end of the
/// process.
class OpenDevices {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::time_point kNever = Clock::time_point::max();

  static OpenDevices& get();

  void add(Device& device);
  void remove(Device& device);
  /// Return when no other thread acts on a device that was removed.
  void await(Device& device);
  /// Have a device held at a time unless this is called again before; return the time that was valid until now.
  Clock::time_point exchange_deadline(Device& device, Clock::time_point deadline);
  void stop_all(const std::string& reason);

 private:
  struct Entry {
    Device* device;
    Clock::time_point deadline = kNever;
  };

  Entry& entry(Device& device);
  void release(Device* device);
  [[noreturn]] void watch();

  std::mutex mutex_;
  std::condition_variable changed_, released_;
  std::vector<Entry> entries_;
  std::vector<Device*> busy_;  // what other threads act on; a device may be there more than once
  Clock::time_point wakes_at_ = kNever;
  bool is_watching_ = false;
};

}  // namespace rcs
