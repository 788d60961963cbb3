#include "rcs/hand.hpp"

#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Hand::Hand(std::string name, int joint_count, int built_for)
    : Device(std::move(name), built_for), joint_count_(joint_count) {
  if (joint_count < 1) throw InvalidSetup(this->name() + ": joint_count must be at least 1");
}

HandState Hand::state() {
  require_open("state");
  HandState state = driven("state", [this] { return do_state(); });
  bool is_valid = static_cast<int>(state.joints.size()) == joint_count_;
  for (const double joint : state.joints) is_valid = is_valid && std::isfinite(joint);
  if (!is_valid) fail("the device measured a wrong number of joints or a value that is not finite");
  require_past("its state", state.time);
  if (std::isnan(state.time)) state.time = monotonic_time();
  return state;
}

void Hand::command_joints(std::span<const double> joints, double valid_for) {
  command("command_joints", valid_for, [&] {
    check_count(name(), "joints", joints, static_cast<std::size_t>(joint_count_));  // before there are as many limits
    const std::vector<double> lower(joints.size(), 0.0), upper(joints.size(), 1.0);
    check_command(name(), "joints", joints, lower, upper);
    driven("command_joints", [&] { do_command_joints(joints); });
  });
}

}  // namespace rcs
