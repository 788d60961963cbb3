// The interface of a gripper with one opening width.
#pragma once

#include <string>

#include "rcs/device.hpp"

namespace rcs {

/// What a gripper measures.
struct GripperState {
  double opening = 0.0;  ///< 0 closed … 1 open
  double force = 0.0;    ///< N, grasping force; 0 when the device does not measure it
  double time = 0.0;     ///< s, on the device's own monotonic clock
};

/// One gripper. An implementation overrides the `do_` functions; users call the others.
class Gripper : public Device {
 public:
  /// `max_width` is the opening at 1 [m], `max_force` the largest grasping force [N].
  Gripper(std::string name, double max_width, double max_force);

  double max_width() const { return max_width_; }
  double max_force() const { return max_force_; }

  GripperState state();
  /// Set the opening (0 closed … 1 open) and return at once. Throws `InvalidCommand`, `WrongOrder`, `DeviceFault`.
  void command_opening(double opening);
  /// Whether the fingers stand still: at the target, or on an object.
  bool has_arrived();
  using Device::hold;

 protected:
  virtual GripperState do_state() = 0;
  virtual void do_command_opening(double opening) = 0;
  virtual bool do_has_arrived() = 0;
  void do_hold() override = 0;

 private:
  double max_width_;
  double max_force_;
};

}  // namespace rcs
