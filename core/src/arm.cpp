#include "rcs/arm.hpp"

#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Arm::Arm(std::string name, ArmLimits limits) : Device(std::move(name)), limits_(std::move(limits)) {
  const std::size_t n = limits_.joint_lower.size();
  if (n == 0 || limits_.joint_upper.size() != n || limits_.joint_velocity.size() != n)
    throw InvalidSetup(this->name() + ": limits need the same, positive number of lower, upper and velocity values");
  for (std::size_t i = 0; i < n; ++i)
    if (!(limits_.joint_lower[i] < limits_.joint_upper[i]) || !(limits_.joint_velocity[i] > 0.0))
      throw InvalidSetup(this->name() + ": limits of joint " + std::to_string(i) +
                         " need lower < upper and velocity > 0");
}

ArmState Arm::state() {
  require_open("state");
  ArmState state = do_state();
  const auto n = limits_.joint_lower.size();
  if (state.joints.size() != n || state.joint_velocities.size() != n)
    fail("the device measured " + std::to_string(state.joints.size()) + " joints, it has " + std::to_string(n));
  for (std::size_t i = 0; i < n; ++i)
    if (!std::isfinite(state.joints[i]) || !std::isfinite(state.joint_velocities[i]))
      fail("the device measured a value that is not finite at joint " + std::to_string(i));
  return state;
}

void Arm::command_joints(std::span<const double> joints) {
  command("command_joints", [&] {
    check_command(name(), "joints", joints, limits_.joint_lower, limits_.joint_upper);
    do_command_joints(joints);
  });
}

bool Arm::has_arrived() {
  require_open("has_arrived");
  return do_has_arrived();
}

}  // namespace rcs
