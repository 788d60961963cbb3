// The parts that all devices share: a name, a connection, deadlines of commands, and a fault that stays until
// `recover`.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <exception>
#include <limits>
#include <mutex>
#include <optional>
#include <span>
#include <string>

#include "rcs/interface.hpp"

namespace rcs {

inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
/// How long a command is valid when nothing else is said.
inline constexpr double kForever = std::numeric_limits<double>::infinity();

/// The host's CLOCK_MONOTONIC [s], which Python's `time.monotonic` reads too.
RCS_API double monotonic_time();

/// The life of a device: closed, open, and a fault that may come in either.
///
/// Threads: `name`, `is_open`, `is_guided`, `fault`, `hold` and `set_fault` may be called from any thread at any time,
/// also while another call is under way. The first four never wait for the device. When `hold` or `set_fault` returns,
/// a command that another thread gave before does not move the device: if it was still under way, the device is held
/// again as soon as it ends. All other calls are for one thread at a time.
///
/// An exception of a driver's function is the device's fault, in its words, and reaches the caller as `DeviceFault`;
/// only the refusal of a command or an option passes as it is.
///
/// An open device can be stopped from elsewhere at any time, so close it before you destroy it.
class RCS_API Device {
 public:
  Device(std::string name, int built_for);
  virtual ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  const std::string& name() const { return name_; }
  bool is_open() const { return is_open_; }
  /// The reason of the fault state, empty when there is none.
  std::string fault() const;

  /// Connect, and read what the device is and where. Nothing is energised and nothing moves: the first command does
  /// that, from the measured state. When it fails, the device is closed again. Opening an open device does nothing.
  void open();
  /// Stop where the device is now and stay there; one that no command has energised stays as it is. Allowed in the
  /// fault state.
  void hold();
  /// True if the last target is reached and the device stands still.
  bool has_arrived();
  /// True if a person can move the device by hand.
  virtual bool can_guide() const { return false; }
  /// Let a person move the device by hand, or hold it again. While it is guided, commands throw `WrongOrder`; `hold`,
  /// a fault and `close` end it. Throws `InvalidCommand` when the device cannot be guided.
  void guide(bool on);
  bool is_guided() const { return is_guided_; }
  /// Enter the fault state and hold: commands are refused until `recover`. The first reason stays; if holding fails,
  /// the fault says that too, and nothing is thrown.
  ///
  /// A driver that looks for faults reads the controller's mode, not its error flags: those may be clear while the
  /// controller still refuses to move, as libfranka's are in its mode "reflex".
  void set_fault(const std::string& reason);
  /// Have the device leave its own fault state, hold where it is now, and only then forget the fault. Throws
  /// `DeviceFault` if one of these fails or a new fault comes meanwhile; the device is then in the fault state.
  void recover();
  /// Hold and let go of the device. Closing twice is harmless. A failure is a fault and is thrown when all is done;
  /// nothing is thrown in the fault state, which is known.
  void close();
  /// True if it can be stopped, unlike a sensor.
  virtual bool moves() const { return true; }

 protected:
  /// Throw `WrongOrder` when the device is not open.
  void require_open(const char* call) const;
  /// Throw `WrongOrder` when not open and `DeviceFault` when in the fault state.
  void require_ready(const char* call) const;
  /// Fail when something was measured later than now, by more than clocks differ: it would never look old.
  void require_past(const char* what, double time);
  /// When the time of the last command is over [s], on the host's monotonic clock: for devices whose own thread keeps
  /// it, so that they do not depend on the thread that calls `hold` then.
  double deadline() const { return deadline_; }
  /// Enter the fault state and throw it.
  [[noreturn]] void fail(const std::string& reason);
  /// Send a command if the device is ready, and have it held when `valid_for` [s] has passed without another. No lock
  /// unless the command or the one before has a deadline, or another thread stops the device meanwhile.
  template <typename Send>
  void command(const char* call, double valid_for, Send send) {
    const std::uint64_t stops = stops_;
    require_commandable(call, valid_for);
    const bool has_deadline = has_deadline_ || valid_for < kForever;
    const TimePoint former = has_deadline ? exchange_deadline(valid_for) : TimePoint::max();
    valid_for_ = valid_for;
    try {
      send();
    } catch (...) {
      if (has_deadline && !has_fault_) restore_deadline(former);
      throw;
    }
    if (stops_ == stops) return;
    hold();
    require_ready(call);
  }

  /// For how long the command that is being sent is valid [s], for a device that keeps the time by itself, too.
  double valid_for() const { return valid_for_; }
  /// Call a function of the driver. An exception becomes the device's fault, and `DeviceFault`.
  template <typename Function>
  auto driven(const char* call, Function function) {
    try {
      return function();
    } catch (const std::exception& error) {
      blame(call, error);
      throw;
    }
  }
  /// The words of an exception of the driver, as a fault; nothing when it refuses a command or an option.
  virtual std::optional<std::string> words_of(const std::exception& error) const;

  /// Connect; energise nothing. After a failure follows `do_close`.
  virtual void do_open() {}
  /// Stop, and end guiding. Runs on the thread that stops, beside whatever else the device does, but never twice at
  /// once, and never beside `do_open` or `do_close`. It throws when the device cannot be reached.
  virtual void do_hold() {}
  /// Return when the device stands still after `do_hold`, or does not in time: where it brakes on a thread of the
  /// program, which may end next.
  virtual void do_await_rest() {}
  virtual bool do_has_arrived() { return true; }
  /// Give way to a person's hand until `do_hold`.
  virtual void do_guide() {}
  /// Return when no thread is about to tell of a fault that was found before: `recover` would take it for a new one.
  virtual void do_settle() {}
  /// Leave the device's own fault state, in which it may refuse to hold.
  virtual void do_recover() {}
  /// Let go of what `do_open` took, all of it or the part that it had when it failed.
  virtual void do_close() {}

 private:
  friend class OpenDevices;
  using TimePoint = std::chrono::steady_clock::time_point;

  void require_commandable(const char* call, double valid_for) const;
  TimePoint exchange_deadline(double valid_for);
  void restore_deadline(TimePoint former);
  void mark_fault(const std::string& reason);
  void blame(const char* call, const std::exception& error);
  std::exception_ptr let_go(const char* call, void (Device::*function)(), bool is_known);
  void stop();
  void lapse();

  const std::string name_;
  std::atomic<bool> is_open_ = false;
  std::atomic<bool> is_guided_ = false;
  std::atomic<bool> has_deadline_ = false;
  std::atomic<double> deadline_ = kForever;
  std::atomic<bool> has_fault_ = false;  // what commands look at, without a lock
  std::atomic<std::uint64_t> stops_ = 0;
  double valid_for_ = kForever;
  std::recursive_mutex holding_;  // recursive: a `do_hold` may find a fault and set it
  bool is_holding_ = false;       // the thread that has the lock is inside of `do_hold`
  mutable std::mutex fault_mutex_;
  std::string fault_;
  bool is_recovering_ = false;  // the next fault is a new one, not a consequence of the first
};

/// Have every open device of this process that moves enter its fault state and hold, all at once; from any thread. All
/// refuse commands before the first one is held. Not to be called from a `do_hold`.
RCS_API void stop_all(const std::string& reason);

/// Throw `InvalidCommand` unless there are as many values as needed.
RCS_API void check_count(const std::string& device, const char* what, std::span<const double> values,
                         std::size_t needed);

/// Throw `InvalidCommand` unless there are as many values as limits, and every value is finite and inside
/// its limits (with 1e-6 to spare for rounding).
RCS_API void check_command(const std::string& device, const char* what, std::span<const double> values,
                           std::span<const double> lower, std::span<const double> upper);

}  // namespace rcs
