// Arm and Gripper: the interfaces with one joint vector and one opening.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>
#include <nanobind/trampoline.h>

#include "arrays.hpp"
#include "rcs/arm.hpp"
#include "rcs/gripper.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

struct PyArm : rcs::Arm {
  NB_TRAMPOLINE(rcs::Arm);
  void do_open() override { NB_OVERRIDE_NAME("_open", do_open); }
  rcs::ArmState do_state() override { NB_OVERRIDE_PURE_NAME("_state", do_state); }
  void do_command_joints(std::span<const double> joints) override {
    nb::detail::ticket ticket(nb_trampoline, "_command_joints", nb::detail::str_hash("_command_joints"), true);
    nb_trampoline.base().attr(ticket.key)(to_array(joints));
  }
  bool do_has_arrived() override { NB_OVERRIDE_PURE_NAME("_has_arrived", do_has_arrived); }
  void do_hold() override { NB_OVERRIDE_PURE_NAME("_hold", do_hold); }
  void do_recover() override { NB_OVERRIDE_NAME("_recover", do_recover); }
  void do_close() override { NB_OVERRIDE_NAME("_close", do_close); }
};

struct PyGripper : rcs::Gripper {
  NB_TRAMPOLINE(rcs::Gripper);
  void do_open() override { NB_OVERRIDE_NAME("_open", do_open); }
  rcs::GripperState do_state() override { NB_OVERRIDE_PURE_NAME("_state", do_state); }
  void do_command_opening(double opening) override {
    NB_OVERRIDE_PURE_NAME("_command_opening", do_command_opening, opening);
  }
  bool do_has_arrived() override { NB_OVERRIDE_PURE_NAME("_has_arrived", do_has_arrived); }
  void do_hold() override { NB_OVERRIDE_PURE_NAME("_hold", do_hold); }
  void do_recover() override { NB_OVERRIDE_NAME("_recover", do_recover); }
  void do_close() override { NB_OVERRIDE_NAME("_close", do_close); }
};

}  // namespace

void bind_arm(nb::module_& m) {
  nb::class_<rcs::ArmLimits>(m, "ArmLimits", "Limits of an arm, one value per joint.")
      .def(nb::init<std::vector<double>, std::vector<double>, std::vector<double>>(), "joint_lower"_a, "joint_upper"_a,
           "joint_velocity"_a, "Lower and upper joint limits [rad] and largest joint velocities [rad/s].")
      .def_prop_ro(
          "joint_lower", [](const rcs::ArmLimits& l) { return to_array(l.joint_lower); }, nb::rv_policy::move,
          "Lower limits [rad].")
      .def_prop_ro(
          "joint_upper", [](const rcs::ArmLimits& l) { return to_array(l.joint_upper); }, nb::rv_policy::move,
          "Upper limits [rad].")
      .def_prop_ro(
          "joint_velocity", [](const rcs::ArmLimits& l) { return to_array(l.joint_velocity); }, nb::rv_policy::move,
          "Largest velocities [rad/s].");
  nb::class_<rcs::ArmState>(m, "ArmState", "What an arm measures.")
      .def(nb::init<std::vector<double>, std::vector<double>, double>(), "joints"_a, "joint_velocities"_a, "time"_a,
           "Joints [rad], joint velocities [rad/s] and the time of measurement [s] on the device's monotonic clock.")
      .def_prop_ro(
          "joints", [](const rcs::ArmState& s) { return to_array(s.joints); }, nb::rv_policy::move,
          "Joint positions [rad].")
      .def_prop_ro(
          "joint_velocities", [](const rcs::ArmState& s) { return to_array(s.joint_velocities); }, nb::rv_policy::move,
          "Joint velocities [rad/s].")
      .def_ro("time", &rcs::ArmState::time, "When it was measured [s].");
  nb::class_<rcs::Arm, PyArm>(m, "Arm",
                              "One manipulator. Subclasses override `_state`, `_command_joints`, `_has_arrived`, "
                              "`_hold` and, where needed, `_open`, `_recover`, `_close`; users call the others.")
      .def(nb::init<std::string, rcs::ArmLimits>(), "name"_a, "limits"_a)
      .def_prop_ro("name", &rcs::Arm::name)
      .def_prop_ro("dof", &rcs::Arm::dof, "Number of joints.")
      .def_prop_ro("limits", &rcs::Arm::limits)
      .def_prop_ro("is_open", &rcs::Arm::is_open)
      .def_prop_ro("fault", &rcs::Arm::fault, "The reason of the fault state, empty when there is none.")
      // An optional override must exist in the base class: nanobind takes a name that it finds nowhere for an error.
      .def(
          "_open", [](rcs::Arm&) {}, "Connect; nothing unless overridden.")
      .def(
          "_recover", [](rcs::Arm&) {}, "Leave the device's own fault state; nothing unless overridden.")
      .def(
          "_close", [](rcs::Arm&) {}, "Let go of the device; nothing unless overridden.")
      .def("open", &rcs::Arm::open, "Connect. Nothing moves. Opening an open arm does nothing.")
      .def("state", &rcs::Arm::state, "Measure joints and velocities.")
      .def(
          "command_joints", [](rcs::Arm& arm, Vector joints) { arm.command_joints(to_span(joints)); }, "joints"_a,
          "Set the joint target [rad] and return at once.\n\nRaises InvalidAction for a wrong size, a value that is "
          "not "
          "finite or out of limits,\nWrongOrder when closed, DeviceFault in the fault state; the arm then holds.")
      .def("has_arrived", &rcs::Arm::has_arrived, "Whether the last target is reached and the arm stands still.")
      .def("hold", &rcs::Arm::hold, "Stop where the arm is now. Allowed in the fault state.")
      .def("set_fault", &rcs::Arm::set_fault, "reason"_a, "Enter the fault state and hold, until `recover`.")
      .def("recover", &rcs::Arm::recover, "Leave the fault state, holding the present position.")
      .def("close", &rcs::Arm::close, "Hold and let go of the device. Closing twice is harmless.");

  nb::class_<rcs::GripperState>(m, "GripperState", "What a gripper measures.")
      .def(nb::init<double, double, double>(), "opening"_a, "force"_a, "time"_a)
      .def_ro("opening", &rcs::GripperState::opening, "0 closed … 1 open.")
      .def_ro("force", &rcs::GripperState::force, "Grasping force [N], 0 when not measured.")
      .def_ro("time", &rcs::GripperState::time, "When it was measured [s].");
  nb::class_<rcs::Gripper, PyGripper>(m, "Gripper",
                                      "One gripper. Subclasses override `_state`, `_command_opening`, `_has_arrived`, "
                                      "`_hold` and, where needed, `_open`, `_recover`, `_close`.")
      .def(nb::init<std::string, double, double>(), "name"_a, "max_width"_a, "max_force"_a)
      .def_prop_ro("name", &rcs::Gripper::name)
      .def_prop_ro("max_width", &rcs::Gripper::max_width, "Opening at 1 [m].")
      .def_prop_ro("max_force", &rcs::Gripper::max_force, "Largest grasping force [N].")
      .def_prop_ro("is_open", &rcs::Gripper::is_open, "Whether the device is connected.")
      .def_prop_ro("fault", &rcs::Gripper::fault)
      .def(
          "_open", [](rcs::Gripper&) {}, "Connect; nothing unless overridden.")
      .def(
          "_recover", [](rcs::Gripper&) {}, "Leave the device's own fault state; nothing unless overridden.")
      .def(
          "_close", [](rcs::Gripper&) {}, "Let go of the device; nothing unless overridden.")
      .def("open", &rcs::Gripper::open, "Connect. Nothing moves.")
      .def("state", &rcs::Gripper::state)
      .def("command_opening", &rcs::Gripper::command_opening, "opening"_a,
           "Set the opening (0 closed … 1 open) and return at once. Raises as `Arm.command_joints` does.")
      .def("has_arrived", &rcs::Gripper::has_arrived,
           "Whether the fingers stand still: at the target, or on an object.")
      .def("hold", &rcs::Gripper::hold)
      .def("set_fault", &rcs::Gripper::set_fault, "reason"_a)
      .def("recover", &rcs::Gripper::recover)
      .def("close", &rcs::Gripper::close, "Hold and let go of the device. Closing twice is harmless.");
}
