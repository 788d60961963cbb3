// One connection of a program to the host of a device. Private to the sources.
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <span>
#include <string>
#include <thread>

#include "host_memory.hpp"
#include "rcs/hosted.hpp"

namespace rcs {

/// Makes calls of a device calls of its host, and looks after the host in a thread.
class HostLink {
 public:
  /// With `is_recovering`, faults are not reported before `recover`.
  HostLink(Device& device, const HostConnection& connection, double answer, bool is_recovering = false);
  ~HostLink();

  /// Whether this thread reports a fault of the host to a device.
  static bool is_telling();

  int process() const { return process_; }
  bool is_lost() const { return is_lost_; }

  /// Ask for a call and wait for its end, or until a command is late.
  HostAnswer ask(HostCall call, std::span<const double> values = {}, double valid_for = kForever, double force = kNaN,
                 double period = 0.0);
  /// The last call: that the host ends the connection after it is no fault.
  void close();
  /// Return when the loss of the host, if it is lost, was reported to the device.
  void settle() const;
  void recover();
  void hold();
  HostMeasured measured();

 private:
  [[noreturn]] void refuse();
  std::string who() const;
  std::string hangs(const std::string& call) const;
  void require_done(const HostAnswer& answer);
  /// False when the time [s] is over first. The host's promise, which the thread looks after, bounds all waiting.
  bool await_end(std::uint32_t number, double seconds);
  void lose(const std::string& reason, bool kills);
  void look_after();
  void tell_of_fault();
  void tell_of_late_refusal();

  Device& device_;
  const double answer_;
  const int socket_, process_, process_file_;
  HostMemory* const memory_;
  std::uint32_t asked_ = 0;
  std::atomic<std::uint32_t> closing_ = 0;  // number of the call that closes the device
  std::atomic<std::uint32_t> seen_ = 0;     // changes of the host's fault that the device knows of
  std::atomic<bool> is_recovering_;
  std::atomic<std::uint32_t> late_ = 0;  // the newest command whose end nobody has waited for
  std::atomic<std::uint32_t> told_ = 0;  // the newest refusal that somebody knows of
  std::atomic<bool> is_lost_ = false, has_told_of_loss_ = false;
  std::atomic<bool> ends_ = false;
  std::mutex mutex_;
  std::string reason_;
  std::thread thread_;
};

}  // namespace rcs
