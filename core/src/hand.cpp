#include "rcs/hand.hpp"

#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Hand::Hand(std::string name, int joint_count) : life_(std::move(name)), joint_count_(joint_count) {
  if (joint_count < 1) throw InvalidSetup(life_.name() + ": joint_count must be at least 1");
}

void Hand::open() {
  if (life_.is_open()) return;
  do_open();
  life_.open();
}

HandState Hand::state() {
  life_.require_open("state");
  HandState state = do_state();
  bool is_valid = static_cast<int>(state.joints.size()) == joint_count_;
  for (const double joint : state.joints) is_valid = is_valid && std::isfinite(joint);
  if (!is_valid) {
    set_fault("the device measured a wrong number of joints or a value that is not finite");
    throw DeviceFault(name() + ": " + fault());
  }
  return state;
}

void Hand::command_joints(std::span<const double> joints) {
  life_.require_ready("command_joints");
  const std::vector<double> lower(static_cast<std::size_t>(joint_count_), 0.0);
  const std::vector<double> upper(static_cast<std::size_t>(joint_count_), 1.0);
  check_command(name(), "joints", joints, lower, upper);
  do_command_joints(joints);
}

bool Hand::has_arrived() {
  life_.require_open("has_arrived");
  return do_has_arrived();
}

void Hand::hold() {
  life_.require_open("hold");
  do_hold();
}

void Hand::set_fault(const std::string& reason) {
  life_.set_fault(reason);
  if (life_.is_open()) do_hold();
}

void Hand::recover() {
  life_.require_open("recover");
  do_hold();
  do_recover();
  life_.clear_fault();
}

void Hand::close() {
  if (!life_.is_open()) return;
  life_.close();
  hold_then_release([this] { do_hold(); }, [this] { do_close(); });
}

}  // namespace rcs
