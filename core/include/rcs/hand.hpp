// The interface of a hand with many joints.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// What a hand measures.
struct HandState {
  std::vector<double> joints;  ///< normalised, 0 … 1 of each joint's range
  double time = 0.0;           ///< s, on the device's own monotonic clock
};

/// One multi-fingered hand. An implementation overrides the `do_` functions; users call the others.
class Hand : public Device {
 public:
  Hand(std::string name, int joint_count);

  int joint_count() const { return joint_count_; }

  HandState state();
  /// Set every joint (normalised, 0 … 1) and return at once. Throws `InvalidCommand`, `WrongOrder`, `DeviceFault`.
  void command_joints(std::span<const double> joints);
  bool has_arrived();
  using Device::hold;

 protected:
  virtual HandState do_state() = 0;
  virtual void do_command_joints(std::span<const double> joints) = 0;
  virtual bool do_has_arrived() = 0;
  void do_hold() override = 0;

 private:
  int joint_count_;
};

}  // namespace rcs
