#include "rcs/gripper.hpp"

#include <array>
#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Gripper::Gripper(std::string name, double max_width, double max_force)
    : Device(std::move(name)), max_width_(max_width), max_force_(max_force) {
  if (!(max_width > 0.0) || !(max_force > 0.0))
    throw InvalidSetup(this->name() + ": max_width [m] and max_force [N] must be positive");
}

GripperState Gripper::state() {
  require_open("state");
  const GripperState state = do_state();
  if (!std::isfinite(state.opening)) fail("the device measured an opening that is not finite");
  return state;
}

void Gripper::command_opening(double opening) {
  command("command_opening", [&] {
    constexpr std::array<double, 1> kLower{0.0}, kUpper{1.0};
    const std::array<double, 1> value{opening};
    check_command(name(), "opening", value, kLower, kUpper);
    do_command_opening(opening);
  });
}

bool Gripper::has_arrived() {
  require_open("has_arrived");
  return do_has_arrived();
}

}  // namespace rcs
