// The interface of a manipulator. Public calls check, the protected ones behind them act.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// Limits of an arm, one value per joint.
struct ArmLimits {
  std::vector<double> joint_lower;     ///< rad
  std::vector<double> joint_upper;     ///< rad
  std::vector<double> joint_velocity;  ///< rad/s, positive
};

/// What an arm measures.
struct ArmState {
  std::vector<double> joints;            ///< rad
  std::vector<double> joint_velocities;  ///< rad/s
  double time = 0.0;                     ///< s, on the device's own monotonic clock
};

/// One manipulator. An implementation in C++ or Python overrides the `do_` functions; users call the others.
class Arm : public Device {
 public:
  Arm(std::string name, ArmLimits limits);

  int dof() const { return static_cast<int>(limits_.joint_lower.size()); }
  const ArmLimits& limits() const { return limits_; }

  /// Measure joints and velocities.
  ArmState state();
  /// Set the joint target [rad] and return at once. Throws `InvalidCommand`, `WrongOrder`, `DeviceFault`; the arm then
  /// holds.
  void command_joints(std::span<const double> joints);
  /// Whether the last target is reached and the arm stands still.
  bool has_arrived();
  using Device::hold;

 protected:
  virtual ArmState do_state() = 0;
  virtual void do_command_joints(std::span<const double> joints) = 0;
  virtual bool do_has_arrived() = 0;
  void do_hold() override = 0;

 private:
  ArmLimits limits_;
};

}  // namespace rcs
