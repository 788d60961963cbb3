// The life of a device: closed, open, and a sticky fault in between. Held by value in every device interface.
#pragma once

#include <span>
#include <string>
#include <vector>

namespace rcs {

/// Whether a device may be used now. Not thread-safe: the owner serialises access.
class Lifecycle {
 public:
  explicit Lifecycle(std::string name) : name_(std::move(name)) {}

  const std::string& name() const { return name_; }
  bool is_open() const { return is_open_; }
  const std::string& fault() const { return fault_; }

  void open() { is_open_ = true; }
  void close() { is_open_ = false; }
  /// Enter the fault state. The first reason stays until `clear_fault`.
  void set_fault(const std::string& reason);
  void clear_fault() { fault_.clear(); }

  /// Throw `WrongOrder` when the device is not open.
  void require_open(const char* call) const;
  /// Throw `WrongOrder` when not open and `DeviceFault` when in the fault state.
  void require_ready(const char* call) const;

 private:
  std::string name_;
  std::string fault_;
  bool is_open_ = false;
};

/// Hold a device and let go of it, also when holding fails. A target must not outlive the connection: the device would
/// move on unwatched, or at the next `open`.
template <typename Hold, typename Release>
void hold_then_release(Hold hold, Release release) {
  try {
    hold();
  } catch (...) {
    release();
    throw;
  }
  release();
}

/// Throw `InvalidCommand` unless every value is finite and inside its limits (with 1e-6 to spare for rounding).
void check_command(const std::string& device, const char* what, std::span<const double> values,
                   std::span<const double> lower, std::span<const double> upper);

}  // namespace rcs
