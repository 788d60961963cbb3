#include "rcs/device.hpp"

#include <cmath>
#include <exception>
#include <sstream>

#include "rcs/result.hpp"

namespace rcs {

namespace {
// A limit that went through float32 comes back up to 1e-7 relative off; that is no reason to refuse it.
constexpr double kTolerance = 1e-6;

// The message of an exception. One from Python has its whole traceback, of which the last line says what happened.
std::string summary(const std::exception& error) {
  std::string text = error.what();
  while (text.ends_with('\n')) text.pop_back();
  return text.starts_with("Traceback ") ? text.substr(text.rfind('\n') + 1) : text;
}
}  // namespace

std::string Device::fault() const {
  const std::lock_guard lock(fault_mutex_);
  return fault_;
}

void Device::open() {
  if (is_open_) return;
  do_open();
  is_open_ = true;
}

void Device::hold() {
  const std::lock_guard lock(holding_);
  require_open("hold");
  ++stops_;
  do_hold();
}

void Device::set_fault(const std::string& reason) {
  {
    const std::lock_guard lock(fault_mutex_);
    if (fault_.empty() || is_recovering_) fault_ = reason.empty() ? "unknown fault" : reason;
    is_recovering_ = false;
    has_fault_ = true;
  }
  const std::lock_guard lock(holding_);
  ++stops_;
  if (!is_open_) return;
  try {
    do_hold();
  } catch (const std::exception& error) {
    // Before the lock: an exception from Python waits for the interpreter to give its message.
    const std::string failure = "; holding failed: " + summary(error);
    const std::lock_guard fault_lock(fault_mutex_);
    if (!fault_.ends_with(failure)) fault_ += failure;
  }
}

void Device::recover() {
  require_open("recover");
  {
    const std::lock_guard lock(fault_mutex_);
    is_recovering_ = true;
  }
  try {
    do_recover();
    hold();
  } catch (const std::exception& error) {
    const std::string failure = "recover failed: " + summary(error);
    const std::lock_guard lock(fault_mutex_);
    if (fault_.empty()) fault_ = failure;
    is_recovering_ = false;
    has_fault_ = true;
    std::throw_with_nested(DeviceFault(name_ + ": " + failure + "; the fault stays (" + fault_ + ")"));
  }
  const std::lock_guard lock(fault_mutex_);
  if (!is_recovering_) throw DeviceFault(name_ + ": a new fault came during recover (" + fault_ + ")");
  is_recovering_ = false;
  has_fault_ = false;
  fault_.clear();
}

void Device::close() {
  {
    const std::lock_guard lock(holding_);
    // The device counts as closed even when letting go of it fails, so that a second close is harmless.
    if (!is_open_.exchange(false)) return;
  }
  // A target must not outlive the connection: the device would move on unwatched, or at the next `open`.
  try {
    do_hold();
  } catch (...) {
    do_close();
    throw;
  }
  do_close();
}

void Device::require_open(const char* call) const {
  if (!is_open_) throw WrongOrder(name_ + ": " + call + " was called on a closed device; call open() first");
}

void Device::require_ready(const char* call) const {
  require_open(call);
  if (has_fault_)
    throw DeviceFault(name_ + ": " + call + " is refused in the fault state (" + fault() + "); call recover() first");
}

void Device::fail(const std::string& reason) {
  set_fault(reason);
  throw DeviceFault(name_ + ": " + fault());
}

void check_count(const std::string& device, const char* what, std::span<const double> values, std::size_t needed) {
  if (values.size() == needed) return;
  throw InvalidCommand(device + ": " + what + " has " + std::to_string(values.size()) + " values, " +
                       std::to_string(needed) + " are needed");
}

void check_command(const std::string& device, const char* what, std::span<const double> values,
                   std::span<const double> lower, std::span<const double> upper) {
  check_count(device, what, values, lower.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i]) && values[i] >= lower[i] - kTolerance && values[i] <= upper[i] + kTolerance) continue;
    std::ostringstream text;
    text << device << ": " << what << "[" << i << "] is " << values[i] << ", valid is " << lower[i] << " to "
         << upper[i];
    throw InvalidCommand(text.str());
  }
}

}  // namespace rcs
