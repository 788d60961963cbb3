#include "rcs/gripper.hpp"

#include <cmath>
#include <sstream>
#include <utility>
#include <vector>

#include "rcs/result.hpp"

namespace rcs {

Gripper::Gripper(std::string name, double max_width, double max_force, int built_for)
    : Device(std::move(name), built_for), max_width_(max_width), max_force_(max_force) {
  if (!(max_width > 0.0) || !(max_force > 0.0))
    throw InvalidSetup(this->name() + ": max_width [m] and max_force [N] must be positive");
}

GripperState Gripper::state() {
  require_open("state");
  GripperState state = driven("state", [this] { return do_state(); });
  if (!std::isfinite(state.opening)) fail("the device measured an opening that is not finite");
  require_past("its state", state.time);
  if (std::isnan(state.time)) state.time = monotonic_time();
  return state;
}

void Gripper::command_opening(double opening, std::optional<double> force, double valid_for) {
  command("command_opening", valid_for, [&] {
    check_command(name(), "opening", std::vector{opening}, std::vector{0.0}, std::vector{1.0});
    if (force && !(*force > 0.0 && *force <= max_force_)) {
      std::ostringstream text;
      text << name() << ": force is " << *force << " N, valid is more than 0 and up to " << max_force_;
      throw InvalidCommand(text.str());
    }
    driven("command_opening", [&] { do_command_opening(opening, force); });
  });
}

}  // namespace rcs
