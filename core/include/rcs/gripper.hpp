// The interface of a gripper with one opening width.
#pragma once

#include <optional>
#include <string>

#include "rcs/device.hpp"

namespace rcs {

/// The measurements of a gripper. NaN stands for one that it does not have.
struct GripperState {
  double opening = 0.0;       ///< 0 closed … 1 open
  double force = kNaN;        ///< N, grasping force
  double time = kNaN;         ///< s, when it was measured, on the host's monotonic clock
  double device_time = kNaN;  ///< s, the same on the device's own clock
};

/// One gripper. An implementation overrides the `do_` functions; users call the others.
class RCS_API Gripper : public Device {
 public:
  /// `max_width` is the opening at 1 [m], `max_force` the largest grasping force [N].
  Gripper(std::string name, double max_width, double max_force, int built_for = kInterfaceVersion);

  double max_width() const { return max_width_; }
  double max_force() const { return max_force_; }

  GripperState state();
  /// Set the opening (0 closed … 1 open) and, where given, the grasping force [N], and return at once. Commands end and
  /// are refused as those of an arm. It has arrived when the fingers stand still: at the target, or on an object.
  void command_opening(double opening, std::optional<double> force = {}, double valid_for = kForever);

 protected:
  virtual GripperState do_state() = 0;
  virtual void do_command_opening(double opening, std::optional<double> force) = 0;
  bool do_has_arrived() override = 0;
  void do_hold() override = 0;

 private:
  double max_width_;
  double max_force_;
};

}  // namespace rcs
