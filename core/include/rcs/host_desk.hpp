// The host's side of the memory that it shares with a program: requests come in, measurements and answers go out.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "rcs/hosted.hpp"

namespace rcs {

struct HostMemory;
/// How much memory a program and a host share for one device [bytes].
std::size_t host_memory_size();

/// One call that the program asks for.
struct HostRequest {
  std::uint32_t number;
  HostCall call;
  std::vector<double> values;
  double valid_for;             ///< s, what is left of it
  std::optional<double> force;  ///< N, of grippers
  double period;                ///< s, between commands to a streamed arm; 0 for the usual one
  std::uint32_t stops;          ///< how often the program had held the device when it asked
  bool is_void;                 ///< the device was held since, so that the request counts no more
};

/// The place where one device of a host is served. A thread holds it when the program says so, ends, or shows no sign
/// of running.
class HostDesk {
 public:
  /// Longest time without a sign of the program [s].
  static constexpr double kSilence = 0.25;

  /// `program` is the number of its process. The files stay those of the caller.
  HostDesk(int memory, int socket, int program, Device& device);
  ~HostDesk();
  HostDesk(const HostDesk&) = delete;
  HostDesk& operator=(const HostDesk&) = delete;

  /// True if the program is still there.
  bool is_used() const { return is_used_; }
  /// Say what is done from now on, and that there is a sign after `seconds` at the latest.
  /// Two threads must not promise at once; in Python, the GIL sees to it.
  void promise(const char* under_way, double seconds);
  /// The next request, or nothing after `seconds` or when the program has ended.
  std::optional<HostRequest> next(double seconds);
  /// Report how a request ended. If the device was held meanwhile, it is held again first.
  void answer(const HostRequest& request, HostOutcome outcome, const std::string& text, bool flag);
  void show(const ArmState& state);
  void show(const GripperState& state);
  void show(const HandState& state);
  /// Say why there is no newer measurement.
  void show_failure(const std::string& reason);

 private:
  void watch();
  void tell_fault();

  Device& device_;
  HostMemory* memory_;
  const int socket_, program_, process_file_;
  std::atomic<bool> is_used_ = true;
  std::atomic<bool> ends_ = false;
  bool is_silent_ = false;
  std::uint32_t last_ = 0;
  std::mutex fault_mutex_;
  std::string told_fault_;
  std::thread watch_;
};

}  // namespace rcs
