#include "rcs/device.hpp"

#include <cmath>
#include <exception>
#include <sstream>
#include <utility>

#include "open_devices.hpp"
#include "rcs/result.hpp"

namespace rcs {

namespace {
// A limit that went through float32 comes back up to 1e-7 relative off; that is no reason to refuse it.
constexpr double kTolerance = 1e-6;
// By how much a time that a driver maps onto the host's clock may be wrong [s].
constexpr double kClockError = 0.1;
// Longer than that is for ever, as far as a clock of nanoseconds goes [s].
constexpr double kLongest = 1e9;

// Why a call of the driver failed. A `DeviceFault` of its own is reason enough.
std::string reason_of(const char* call, const std::exception& error, const std::string& words) {
  return dynamic_cast<const DeviceFault*>(&error) ? words : std::string(call) + " failed: " + words;
}
}  // namespace

void require_interface(int built_for) {
  if (built_for == kInterfaceVersion) return;
  throw InvalidSetup("this device was compiled for version " + std::to_string(built_for) +
                     " of the device interfaces, the installed robot-control-stack has version " +
                     std::to_string(kInterfaceVersion) + "; compile the device anew against it");
}

double monotonic_time() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

Device::Device(std::string name, int built_for) : name_(std::move(name)) { require_interface(built_for); }

Device::~Device() {
  OpenDevices::get().remove(*this);
  OpenDevices::get().await(*this);
}

std::string Device::fault() const {
  const std::lock_guard lock(fault_mutex_);
  return fault_;
}

std::optional<std::string> Device::words_of(const std::exception& error) const {
  if (dynamic_cast<const InvalidCommand*>(&error) || dynamic_cast<const InvalidSetup*>(&error) ||
      dynamic_cast<const WrongOrder*>(&error))
    return {};
  const std::string words = error.what(), own = name_ + ": ";
  return words.starts_with(own) ? words.substr(own.size()) : words;
}

void Device::blame(const char* call, const std::exception& error) {
  const auto words = words_of(error);
  if (!words) return;
  std::string reason = reason_of(call, error, *words);
  if (!has_fault_) {
    set_fault(reason);
    reason = fault();
  }
  std::throw_with_nested(DeviceFault(name_ + ": " + reason));
}

void Device::open() {
  if (is_open_) return;
  try {
    do_open();
  } catch (const std::exception& error) {
    const auto words = words_of(error);
    std::string reason = words ? reason_of("open", error, *words) : "";
    try {
      do_close();
    } catch (const std::exception& also) {
      const auto said = words_of(also);
      reason += "; close failed: " + (said ? *said : also.what());
    }
    if (!words) throw;
    std::throw_with_nested(DeviceFault(name_ + ": " + reason));
  }
  is_open_ = true;
  OpenDevices::get().add(*this);
}

void Device::stop() {
  // Before the count: a command whose deadline this takes away sees that it was stopped, or is held below.
  deadline_ = kForever;
  if (has_deadline_.exchange(false)) OpenDevices::get().exchange_deadline(*this, OpenDevices::kNever);
  ++stops_;
  is_guided_ = false;
  if (std::exchange(is_holding_, true)) return;
  try {
    do_hold();
  } catch (...) {
    is_holding_ = false;
    throw;
  }
  is_holding_ = false;
}

void Device::hold() {
  const std::lock_guard lock(holding_);
  require_open("hold");
  try {
    stop();
  } catch (const std::exception& error) {
    const auto words = words_of(error);
    if (!words) throw;
    const std::string reason = reason_of("hold", error, *words);
    mark_fault(reason);  // and no more: to hold is what has just failed
    std::throw_with_nested(DeviceFault(name_ + ": " + reason));
  }
}

bool Device::has_arrived() {
  require_open("has_arrived");
  return driven("has_arrived", [this] { return do_has_arrived(); });
}

void Device::guide(bool on) {
  require_ready("guide");
  if (!can_guide()) throw InvalidCommand(name_ + ": this device cannot be guided by hand (can_guide is false)");
  if (on == is_guided_) return;
  if (!on) return hold();
  command("guide", kForever, [this] {
    driven("guide", [this] { do_guide(); });
    is_guided_ = true;
  });
}

void Device::require_commandable(const char* call, double valid_for) const {
  require_ready(call);
  if (is_guided_)
    throw WrongOrder(name_ + ": " + call + " is refused while the device is guided; call guide(false) first");
  if (valid_for > 0.0) return;
  std::ostringstream text;
  text << name_ << ": " << call << " is valid for " << valid_for << " s, it must be more than 0";
  throw InvalidCommand(text.str());
}

Device::TimePoint Device::exchange_deadline(double valid_for) {
  using std::chrono::steady_clock;
  const bool is_ending = valid_for < kLongest;
  deadline_ = is_ending ? monotonic_time() + valid_for : kForever;
  const std::chrono::duration<double> time(is_ending ? valid_for : 0.0);
  const TimePoint former = OpenDevices::get().exchange_deadline(
      *this,
      is_ending ? steady_clock::now() + std::chrono::duration_cast<steady_clock::duration>(time) : OpenDevices::kNever);
  has_deadline_ = is_ending;  // last: a stop that comes between would leave a deadline that nobody takes away
  return former;
}

void Device::restore_deadline(TimePoint former) {
  const bool is_ending = former < OpenDevices::kNever;
  deadline_ = is_ending ? std::chrono::duration<double>(former.time_since_epoch()).count() : kForever;
  OpenDevices::get().exchange_deadline(*this, former);
  has_deadline_ = is_ending;
}

// A command that arrives while the device is held here is held too: it is later than the end of the one before.
void Device::lapse() {
  const std::lock_guard lock(holding_);
  if (!is_open_) return;
  try {
    stop();
  } catch (const std::exception&) {
    set_fault("the time of the last command is over");  // holds again, and says that this fails
  }
}

void Device::mark_fault(const std::string& reason) {
  const std::lock_guard lock(fault_mutex_);
  if (fault_.empty() || is_recovering_) fault_ = reason.empty() ? "unknown fault" : reason;
  is_recovering_ = false;
  has_fault_ = true;
}

void Device::set_fault(const std::string& reason) {
  mark_fault(reason);
  const std::lock_guard lock(holding_);
  if (!is_open_) return;
  try {
    stop();
  } catch (const std::exception& error) {
    // Before the lock: an exception from Python waits for the interpreter to give its message.
    const auto said = words_of(error);
    const std::string words = said ? *said : error.what();
    const std::lock_guard fault_lock(fault_mutex_);
    if (fault_.find(words) == std::string::npos) fault_ += "; hold failed: " + words;
  }
}

void Device::recover() {
  require_open("recover");
  do_settle();
  {
    const std::lock_guard lock(fault_mutex_);
    is_recovering_ = true;
  }
  try {
    do_recover();
    const std::lock_guard lock(holding_);
    require_open("recover");
    stop();
  } catch (const std::exception& error) {
    const auto words = words_of(error);
    const std::string failure = "recover failed: " + (words ? *words : error.what());
    const std::lock_guard lock(fault_mutex_);
    if (fault_.empty()) fault_ = failure;
    is_recovering_ = false;
    has_fault_ = true;
    if (!words) throw;
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
    is_guided_ = has_deadline_ = false;
    deadline_ = kForever;
  }
  OpenDevices::get().remove(*this);
  const bool is_known = has_fault_;  // a fault from before: the user of the device knows it
  // A target must not outlive the connection: the device would move on unwatched, or at the next `open`.
  const std::exception_ptr unheld = let_go("hold", &Device::do_hold, is_known);
  const std::exception_ptr unclosed = let_go("close", &Device::do_close, is_known);
  if (unheld || unclosed) std::rethrow_exception(unheld ? unheld : unclosed);
}

std::exception_ptr Device::let_go(const char* call, void (Device::*function)(), bool is_known) try {
  (this->*function)();
  return nullptr;
} catch (const std::exception& error) {
  const auto words = words_of(error);
  if (!words) return std::current_exception();
  if (is_known) return nullptr;
  const std::string reason = reason_of(call, error, *words);
  mark_fault(reason);
  try {
    std::throw_with_nested(DeviceFault(name_ + ": " + reason));
  } catch (...) {
    return std::current_exception();
  }
} catch (...) {
  return std::current_exception();
}

void Device::require_open(const char* call) const {
  if (!is_open_) throw WrongOrder(name_ + ": " + call + " was called on a closed device; call open() first");
}

void Device::require_ready(const char* call) const {
  require_open(call);
  if (has_fault_)
    throw DeviceFault(name_ + ": " + call + " is refused in the fault state (" + fault() + "); call recover() first");
}

void Device::require_past(const char* what, double time) {
  const double ahead = time - monotonic_time();
  if (!(ahead > kClockError)) return;
  std::ostringstream text;
  text << "the time of " << what << " is " << ahead
       << " s ahead of the host's monotonic clock; give that of another clock as device_time";
  fail(text.str());
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
