// The interface of a manipulator. Public calls check, the protected ones behind them act.
#pragma once

#include <cstdint>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "rcs/device.hpp"
#include "rcs/pose.hpp"

namespace rcs {

/// A kind of command. Every arm takes joints.
enum class CommandKind : std::uint8_t { joints, pose, twist, velocities, torques };

/// Limits of an arm, one value per joint. The last three are empty where they are unknown.
struct ArmLimits {
  std::vector<double> joint_lower;           ///< rad
  std::vector<double> joint_upper;           ///< rad
  std::vector<double> joint_velocity;        ///< rad/s, positive
  std::vector<double> joint_acceleration{};  ///< rad/s², positive
  std::vector<double> joint_jerk{};          ///< rad/s³, positive
  std::vector<double> joint_effort{};        ///< N·m, positive
};

/// The measurements of an arm. A missing value is empty, or NaN.
struct ArmState {
  std::vector<double> joints;              ///< rad
  std::vector<double> joint_velocities;    ///< rad/s
  double time = kNaN;                      ///< s, when it was measured, on the host's monotonic clock
  double device_time = kNaN;               ///< s, the same on the device's own clock
  std::vector<double> commanded_joints{};  ///< rad, where the controller wants the joints to be
  std::vector<double> efforts{};           ///< N·m, at the joints
  std::vector<double> wrench{};            ///< N, N·m, on the TCP, in the frame of the base; 6 values
  /// The controller's name for what it is doing; "starting" while a streamed arm is switched on, and measures nothing.
  std::string mode{};
};

/// One manipulator. An implementation in C++ or Python overrides the `do_` functions; users call the others.
///
/// A command sets a target and returns at once. Without another one it ends after `valid_for` [s]: the arm then holds
/// by itself. A command throws `InvalidCommand`, `WrongOrder` or `DeviceFault`; it then changes nothing.
class RCS_API Arm : public Device {
 public:
  /// `more_commands` are the kinds that it takes besides joints; their `do_` functions are to be overridden.
  Arm(std::string name, ArmLimits limits, std::set<CommandKind> more_commands = {}, int built_for = kInterfaceVersion);

  int dof() const { return static_cast<int>(limits_.joint_lower.size()); }
  const ArmLimits& limits() const { return limits_; }
  const std::set<CommandKind>& commands() const { return commands_; }

  ArmState state();
  /// Joint targets [rad], within the limits. A joint that was found outside may stay there and come back: its target
  /// may be as far out as where it was measured since the last command, or sent by that.
  void command_joints(std::span<const double> joints, double valid_for = kForever);
  /// The goal of the TCP.
  void command_pose(const Pose& pose_tcp_in_base, double valid_for = kForever);
  /// Velocity of the TCP in the frame of the base: 3 × m/s, 3 × rad/s.
  void command_twist(std::span<const double> twist, double valid_for = kForever);
  /// Joint velocities [rad/s], within the limits.
  void command_velocities(std::span<const double> velocities, double valid_for = kForever);
  /// Joint torques [N·m] besides gravity, within the limits where they are known.
  void command_torques(std::span<const double> torques, double valid_for = kForever);

 protected:
  virtual ArmState do_state() = 0;
  virtual void do_command_joints(std::span<const double> joints) = 0;
  virtual void do_command_pose(const Pose& pose_tcp_in_base);
  virtual void do_command_twist(std::span<const double> twist);
  virtual void do_command_velocities(std::span<const double> velocities);
  virtual void do_command_torques(std::span<const double> torques);
  bool do_has_arrived() override = 0;
  void do_hold() override = 0;

 private:
  void require_kind(CommandKind kind) const;

  ArmLimits limits_;
  std::set<CommandKind> commands_;
  std::vector<double> target_;  // the last one [rad]
  // Measured since then [rad]: a target may be computed from any measurement, also when a joint that is out of
  // its range has moved by a step of its encoder since.
  std::vector<double> least_, most_;
  bool is_commanded_ = true;           // and nothing was measured since
  std::vector<double> lower_, upper_;  // what the next target is checked against [rad]
};

}  // namespace rcs
