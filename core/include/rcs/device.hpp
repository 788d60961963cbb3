// What all devices share: a name, a connection, and a fault that stays until `recover`.
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <span>
#include <string>

namespace rcs {

/// The life of a device: closed, open, and a fault that may come in either.
///
/// Threads: `name`, `is_open`, `fault`, `hold` and `set_fault` may be called from any thread at any time, also while
/// another call is under way. The first three never wait for the device. When `hold` or `set_fault` returns, a command
/// that another thread gave before does not move the device: if it was still under way, the device is held again as
/// soon as it ends. All other calls are for one thread at a time.
class Device {
 public:
  explicit Device(std::string name) : name_(std::move(name)) {}
  virtual ~Device() = default;
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  const std::string& name() const { return name_; }
  bool is_open() const { return is_open_; }
  /// The reason of the fault state, empty when there is none.
  std::string fault() const;

  /// Connect. Nothing moves. Opening an open device does nothing.
  void open();
  /// Enter the fault state and hold: commands are refused until `recover`. The first reason stays; if holding fails,
  /// the fault says that too, and nothing is thrown.
  ///
  /// A driver that looks for faults reads the controller's mode, not its error flags: those may be clear while the
  /// controller still refuses to move, as libfranka's are in its mode "reflex".
  void set_fault(const std::string& reason);
  /// Have the device leave its own fault state, hold where it is now, and only then forget the fault. Throws
  /// `DeviceFault` if one of these fails or a new fault comes meanwhile; the device is then in the fault state.
  void recover();
  /// Hold and let go of the device. Closing twice is harmless.
  void close();

 protected:
  /// Stop where the device is now and stay there. Allowed in the fault state. Public in devices that move.
  void hold();

  /// Throw `WrongOrder` when the device is not open.
  void require_open(const char* call) const;
  /// Throw `WrongOrder` when not open and `DeviceFault` when in the fault state.
  void require_ready(const char* call) const;
  /// Enter the fault state and throw it.
  [[noreturn]] void fail(const std::string& reason);
  /// Send a command if the device is ready. No lock unless another thread stops the device meanwhile.
  template <typename Send>
  void command(const char* call, Send send) {
    const std::uint64_t stops = stops_;
    require_ready(call);
    send();
    if (stops_ == stops) return;
    hold();
    require_ready(call);
  }

  virtual void do_open() {}
  /// Runs on the thread that stops, beside whatever else the device does, but never twice at once, and never beside
  /// `do_open` or `do_close`.
  virtual void do_hold() {}
  /// Leave the device's own fault state, in which it may refuse to hold.
  virtual void do_recover() {}
  virtual void do_close() {}

 private:
  const std::string name_;
  std::atomic<bool> is_open_ = false;
  std::atomic<bool> has_fault_ = false;  // what commands look at, without a lock
  std::atomic<std::uint64_t> stops_ = 0;
  std::recursive_mutex holding_;  // recursive: a `do_hold` may find a fault and set it
  mutable std::mutex fault_mutex_;
  std::string fault_;
  bool is_recovering_ = false;  // the next fault is a new one, not a consequence of the first
};

/// Throw `InvalidCommand` unless there are as many values as needed.
void check_count(const std::string& device, const char* what, std::span<const double> values, std::size_t needed);

/// Throw `InvalidCommand` unless there are as many values as limits, and every value is finite and inside
/// its limits (with 1e-6 to spare for rounding).
void check_command(const std::string& device, const char* what, std::span<const double> values,
                   std::span<const double> lower, std::span<const double> upper);

}  // namespace rcs
