#include "rcs/hand.hpp"

#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Hand::Hand(std::string name, int joint_count) : Device(std::move(name)), joint_count_(joint_count) {
  if (joint_count < 1) throw InvalidSetup(this->name() + ": joint_count must be at least 1");
}

HandState Hand::state() {
  require_open("state");
  HandState state = do_state();
  bool is_valid = static_cast<int>(state.joints.size()) == joint_count_;
  for (const double joint : state.joints) is_valid = is_valid && std::isfinite(joint);
  if (!is_valid) fail("the device measured a wrong number of joints or a value that is not finite");
  return state;
}

void Hand::command_joints(std::span<const double> joints) {
  command("command_joints", [&] {
    check_count(name(), "joints", joints, static_cast<std::size_t>(joint_count_));  // before there are as many limits
    const std::vector<double> lower(joints.size(), 0.0), upper(joints.size(), 1.0);
    check_command(name(), "joints", joints, lower, upper);
    do_command_joints(joints);
  });
}

bool Hand::has_arrived() {
  require_open("has_arrived");
  return do_has_arrived();
}

}  // namespace rcs
