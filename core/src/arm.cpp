#include "rcs/arm.hpp"

#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Arm::Arm(std::string name, ArmLimits limits) : life_(std::move(name)), limits_(std::move(limits)) {
  const std::size_t n = limits_.joint_lower.size();
  if (n == 0 || limits_.joint_upper.size() != n || limits_.joint_velocity.size() != n)
    throw InvalidSetup(life_.name() + ": limits need the same, positive number of lower, upper and velocity values");
  for (std::size_t i = 0; i < n; ++i)
    if (!(limits_.joint_lower[i] < limits_.joint_upper[i]) || !(limits_.joint_velocity[i] > 0.0))
      throw InvalidSetup(life_.name() + ": limits of joint " + std::to_string(i) +
                         " need lower < upper and velocity > 0");
}

void Arm::open() {
  if (life_.is_open()) return;
  do_open();
  life_.open();
}

ArmState Arm::state() {
  life_.require_open("state");
  ArmState state = do_state();
  const auto n = limits_.joint_lower.size();
  if (state.joints.size() != n || state.joint_velocities.size() != n) {
    set_fault("the device measured " + std::to_string(state.joints.size()) + " joints, it has " + std::to_string(n));
    throw DeviceFault(name() + ": " + fault());
  }
  for (std::size_t i = 0; i < n; ++i)
    if (!std::isfinite(state.joints[i]) || !std::isfinite(state.joint_velocities[i])) {
      set_fault("the device measured a value that is not finite at joint " + std::to_string(i));
      throw DeviceFault(name() + ": " + fault());
    }
  return state;
}

void Arm::command_joints(std::span<const double> joints) {
  life_.require_ready("command_joints");
  check_command(name(), "joints", joints, limits_.joint_lower, limits_.joint_upper);
  do_command_joints(joints);
}

bool Arm::has_arrived() {
  life_.require_open("has_arrived");
  return do_has_arrived();
}

void Arm::hold() {
  life_.require_open("hold");
  do_hold();
}

void Arm::set_fault(const std::string& reason) {
  life_.set_fault(reason);
  if (life_.is_open()) do_hold();
}

void Arm::recover() {
  life_.require_open("recover");
  do_hold();
  do_recover();
  life_.clear_fault();
}

void Arm::close() {
  if (!life_.is_open()) return;
  // The device counts as closed even when letting go of it fails, so that a second close is harmless.
  life_.close();
  hold_then_release([this] { do_hold(); }, [this] { do_close(); });
}

}  // namespace rcs
