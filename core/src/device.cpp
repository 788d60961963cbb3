#include "rcs/device.hpp"

#include <cmath>
#include <sstream>

#include "rcs/result.hpp"

namespace rcs {

namespace {
// A limit that went through float32 comes back up to 1e-7 relative off; that is no reason to refuse it.
constexpr double kTolerance = 1e-6;
}  // namespace

void Lifecycle::set_fault(const std::string& reason) {
  if (fault_.empty()) fault_ = reason.empty() ? "unknown fault" : reason;
}

void Lifecycle::require_open(const char* call) const {
  if (!is_open_) throw WrongOrder(name_ + ": " + call + " was called on a closed device; call open() first");
}

void Lifecycle::require_ready(const char* call) const {
  require_open(call);
  if (!fault_.empty())
    throw DeviceFault(name_ + ": " + call + " is refused in the fault state (" + fault_ + "); call recover() first");
}

void check_command(const std::string& device, const char* what, std::span<const double> values,
                   std::span<const double> lower, std::span<const double> upper) {
  if (values.size() != lower.size()) {
    std::ostringstream text;
    text << device << ": " << what << " has " << values.size() << " values, " << lower.size() << " are needed";
    throw InvalidCommand(text.str());
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i]) && values[i] >= lower[i] - kTolerance && values[i] <= upper[i] + kTolerance) continue;
    std::ostringstream text;
    text << device << ": " << what << "[" << i << "] is " << values[i] << ", valid is " << lower[i] << " to "
         << upper[i];
    throw InvalidCommand(text.str());
  }
}

}  // namespace rcs
