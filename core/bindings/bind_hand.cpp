// Gripper and Hand: the interfaces of what grasps.
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include <optional>

#include "overrides.hpp"
#include "rcs/gripper.hpp"
#include "rcs/hand.hpp"

using namespace nb::literals;

namespace {

struct PyGripper : PyDevice<rcs::Gripper> {
  using PyDevice::PyDevice;
  rcs::GripperState do_state() override { return call<rcs::GripperState>("_state", "a GripperState"); }
  void do_command_opening(double opening, std::optional<double> force) override {
    call<void>("_command_opening", "None", opening, force);
  }
};

struct PyHand : PyDevice<rcs::Hand> {
  using PyDevice::PyDevice;
  rcs::HandState do_state() override { return call<rcs::HandState>("_state", "a HandState"); }
  void do_command_joints(std::span<const double> joints) override { call<void>("_command_joints", "None", joints); }
};

}  // namespace

void bind_hand(nb::module_& m) {
  using rcs::Gripper, rcs::GripperState, rcs::Hand, rcs::HandState;
  nb::class_<GripperState> gripper_state(m, "GripperState", "The measurements of a gripper.");
  gripper_state
      .def(nb::init<double, double, double, double>(), "opening"_a, "force"_a = rcs::kNaN, "time"_a = rcs::kNaN,
           "device_time"_a = rcs::kNaN)
      .def_ro("opening", &GripperState::opening, "0 closed … 1 open.")
      .def_ro("force", &GripperState::force, "Grasping force [N], NaN when not measured.");
  def_times(gripper_state);
  nb::class_<Gripper, rcs::Device, PyGripper>(
      m, "Gripper",
      "One gripper. Subclasses override `_state`, `_command_opening`, `_has_arrived`, `_hold` and, where needed, "
      "`_open`,\n`_recover`, `_close`, `_can_guide`, `_guide`.")
      .def(nb::init<std::string, double, double>(), "name"_a, "max_width"_a, "max_force"_a)
      .def_prop_ro("max_width", &Gripper::max_width, "Opening at 1 [m].")
      .def_prop_ro("max_force", &Gripper::max_force, "Largest grasping force [N].")
      .def("state", &Gripper::state, WithoutGil(), "Measure the gripper.")
      .def("command_opening", &Gripper::command_opening, WithoutGil(), "opening"_a, "force"_a = nb::none(),
           "valid_for"_a = rcs::kForever,
           "Set the opening (0 closed … 1 open) and, where given, the grasping force [N]; ends and raises as "
           "`Arm.command_joints`.\n\nIt has arrived when the fingers stand still: at the target, or on an object.");

  nb::class_<HandState> hand_state(m, "HandState", "The measurements of a hand.");
  hand_state.def(nb::init<std::vector<double>, double, double>(), "joints"_a, "time"_a = rcs::kNaN,
                 "device_time"_a = rcs::kNaN);
  def_array(hand_state, "joints", &HandState::joints, "Normalised joints, 0 … 1.");
  def_times(hand_state);
  nb::class_<Hand, rcs::Device, PyHand>(
      m, "Hand",
      "One multi-fingered hand. Subclasses override `_state`, `_command_joints`, `_has_arrived`, `_hold` and, where "
      "needed,\n`_open`, `_recover`, `_close`, `_can_guide`, `_guide`.")
      .def(nb::init<std::string, int>(), "name"_a, "joint_count"_a)
      .def_prop_ro("joint_count", &Hand::joint_count)
      .def("state", &Hand::state, WithoutGil(), "Measure the hand.")
      .def("command_joints", vector_command(&Hand::command_joints), "joints"_a, "valid_for"_a = rcs::kForever,
           "Set every joint (normalised, 0 … 1); ends and raises as `Arm.command_joints`.");
}
