// The interface of a hand with many joints.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// The measurements of a hand.
struct HandState {
  std::vector<double> joints;  ///< normalised, 0 … 1 of each joint's range
  double time = kNaN;          ///< s, when it was measured, on the host's monotonic clock
  double device_time = kNaN;   ///< s, the same on the device's own clock; NaN when it has none
};

/// One multi-fingered hand. An implementation overrides the `do_` functions; users call the others.
class RCS_API Hand : public Device {
 public:
  Hand(std::string name, int joint_count, int built_for = kInterfaceVersion);

  int joint_count() const { return joint_count_; }

  HandState state();
  /// Set every joint (normalised, 0 … 1) and return at once. Commands end and are refused as those of an arm.
  void command_joints(std::span<const double> joints, double valid_for = kForever);

 protected:
  virtual HandState do_state() = 0;
  virtual void do_command_joints(std::span<const double> joints) = 0;
  bool do_has_arrived() override = 0;
  void do_hold() override = 0;

 private:
  int joint_count_;
};

}  // namespace rcs
