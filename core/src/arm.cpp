#include "rcs/arm.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

constexpr std::array kNames{"joints", "pose", "twist", "velocities", "torques"};

const char* name_of(CommandKind kind) { return kNames.at(static_cast<std::size_t>(kind)); }

std::vector<double> negated(std::vector<double> values) {
  for (double& value : values) value = -value;
  return values;
}

}  // namespace

Arm::Arm(std::string name, ArmLimits limits, std::set<CommandKind> more_commands, int built_for)
    : Device(std::move(name), built_for), limits_(std::move(limits)), commands_(std::move(more_commands)) {
  commands_.insert(CommandKind::joints);
  const std::size_t n = limits_.joint_lower.size();
  if (n == 0 || limits_.joint_upper.size() != n || limits_.joint_velocity.size() != n)
    throw InvalidSetup(this->name() + ": limits need the same, positive number of lower, upper and velocity values");
  for (std::size_t i = 0; i < n; ++i)
    if (!(limits_.joint_lower[i] < limits_.joint_upper[i]) || !(limits_.joint_velocity[i] > 0.0))
      throw InvalidSetup(this->name() + ": limits of joint " + std::to_string(i) +
                         " need lower < upper and velocity > 0");
  for (const auto* values : {&limits_.joint_acceleration, &limits_.joint_jerk, &limits_.joint_effort}) {
    bool is_valid = values->empty() || values->size() == n;
    for (const double value : *values) is_valid = is_valid && value > 0.0;
    if (!is_valid)
      throw InvalidSetup(this->name() + ": limits of acceleration, jerk and effort need a positive value per joint, " +
                         "or none where they are unknown");
  }
  target_ = least_ = lower_ = limits_.joint_lower;
  most_ = upper_ = limits_.joint_upper;
}

ArmState Arm::state() {
  require_open("state");
  ArmState state = driven("state", [this] { return do_state(); });
  const auto n = limits_.joint_lower.size();
  if (state.joints.size() != n || state.joint_velocities.size() != n)
    fail("the device measured " + std::to_string(state.joints.size()) + " joints, it has " + std::to_string(n));
  for (std::size_t i = 0; i < n; ++i)
    if (!std::isfinite(state.joints[i]) || !std::isfinite(state.joint_velocities[i]))
      fail("the device measured a value that is not finite at joint " + std::to_string(i));
  const auto check = [this](const char* what, const std::vector<double>& values, std::size_t needed) {
    bool is_valid = values.empty() || values.size() == needed;
    for (const double value : values) is_valid = is_valid && std::isfinite(value);
    if (!is_valid) fail(std::string("the device measured ") + what + " of a wrong number or not finite");
  };
  check("commanded joints", state.commanded_joints, n);
  check("efforts", state.efforts, n);
  check("a wrench", state.wrench, 6);
  require_past("its state", state.time);
  if (std::isnan(state.time)) state.time = monotonic_time();
  if (is_commanded_) least_ = most_ = state.joints;
  is_commanded_ = false;
  for (std::size_t i = 0; i < n; ++i) {
    least_[i] = std::min(least_[i], state.joints[i]);
    most_[i] = std::max(most_[i], state.joints[i]);
  }
  return state;
}

void Arm::command_joints(std::span<const double> joints, double valid_for) {
  command("command_joints", valid_for, [&] {
    for (std::size_t i = 0; i < limits_.joint_lower.size(); ++i) {
      lower_[i] = std::min({limits_.joint_lower[i], least_[i], target_[i]});
      upper_[i] = std::max({limits_.joint_upper[i], most_[i], target_[i]});
    }
    check_command(name(), "joints", joints, lower_, upper_);
    driven("command_joints", [&] { do_command_joints(joints); });
    target_.assign(joints.begin(), joints.end());
    is_commanded_ = true;
  });
}

void Arm::command_pose(const Pose& pose_tcp_in_base, double valid_for) {
  command("command_pose", valid_for, [&] {
    require_kind(CommandKind::pose);
    driven("command_pose", [&] { do_command_pose(pose_tcp_in_base); });
  });
}

void Arm::command_twist(std::span<const double> twist, double valid_for) {
  command("command_twist", valid_for, [&] {
    require_kind(CommandKind::twist);
    const std::vector<double> limit(6, kForever);
    check_command(name(), "twist", twist, negated(limit), limit);
    driven("command_twist", [&] { do_command_twist(twist); });
  });
}

void Arm::command_velocities(std::span<const double> velocities, double valid_for) {
  command("command_velocities", valid_for, [&] {
    require_kind(CommandKind::velocities);
    check_command(name(), "velocities", velocities, negated(limits_.joint_velocity), limits_.joint_velocity);
    driven("command_velocities", [&] { do_command_velocities(velocities); });
  });
}

void Arm::command_torques(std::span<const double> torques, double valid_for) {
  command("command_torques", valid_for, [&] {
    require_kind(CommandKind::torques);
    const std::vector<double> limit =
        limits_.joint_effort.empty() ? std::vector<double>(limits_.joint_lower.size(), kForever) : limits_.joint_effort;
    check_command(name(), "torques", torques, negated(limit), limit);
    driven("command_torques", [&] { do_command_torques(torques); });
  });
}

void Arm::require_kind(CommandKind kind) const {
  if (commands_.contains(kind)) return;
  std::string known;
  for (const CommandKind command : commands_) known += (known.empty() ? "" : ", ") + std::string(name_of(command));
  throw InvalidCommand(name() + ": this arm takes no " + name_of(kind) + "; it takes " + known);
}

namespace {
[[noreturn]] void refuse(const Arm& arm, CommandKind kind) {
  throw InvalidCommand(arm.name() + ": this arm says that it takes " + name_of(kind) +
                       ", but its driver does not override that command");
}
}  // namespace

void Arm::do_command_pose(const Pose&) { refuse(*this, CommandKind::pose); }
void Arm::do_command_twist(std::span<const double>) { refuse(*this, CommandKind::twist); }
void Arm::do_command_velocities(std::span<const double>) { refuse(*this, CommandKind::velocities); }
void Arm::do_command_torques(std::span<const double>) { refuse(*this, CommandKind::torques); }

}  // namespace rcs
