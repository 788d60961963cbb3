#include "rcs/gripper.hpp"

#include <array>
#include <cmath>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

Gripper::Gripper(std::string name, double max_width, double max_force)
    : life_(std::move(name)), max_width_(max_width), max_force_(max_force) {
  if (!(max_width > 0.0) || !(max_force > 0.0))
    throw InvalidSetup(life_.name() + ": max_width [m] and max_force [N] must be positive");
}

void Gripper::open() {
  if (life_.is_open()) return;
  do_open();
  life_.open();
}

GripperState Gripper::state() {
  life_.require_open("state");
  const GripperState state = do_state();
  if (!std::isfinite(state.opening)) {
    set_fault("the device measured an opening that is not finite");
    throw DeviceFault(name() + ": " + fault());
  }
  return state;
}

void Gripper::command_opening(double opening) {
  life_.require_ready("command_opening");
  constexpr std::array<double, 1> kLower{0.0}, kUpper{1.0};
  const std::array<double, 1> value{opening};
  check_command(name(), "opening", value, kLower, kUpper);
  do_command_opening(opening);
}

bool Gripper::has_arrived() {
  life_.require_open("has_arrived");
  return do_has_arrived();
}

void Gripper::hold() {
  life_.require_open("hold");
  do_hold();
}

void Gripper::set_fault(const std::string& reason) {
  life_.set_fault(reason);
  if (life_.is_open()) do_hold();
}

void Gripper::recover() {
  life_.require_open("recover");
  do_hold();
  do_recover();
  life_.clear_fault();
}

void Gripper::close() {
  if (!life_.is_open()) return;
  life_.close();
  hold_then_release([this] { do_hold(); }, [this] { do_close(); });
}

}  // namespace rcs
