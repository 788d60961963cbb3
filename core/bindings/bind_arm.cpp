// Arm and Gripper: the interfaces with one joint vector and one opening.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "overrides.hpp"
#include "rcs/arm.hpp"
#include "rcs/gripper.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

struct PyArm : PyDevice<rcs::Arm> {
  using PyDevice::PyDevice;
  rcs::ArmState do_state() override { return call<rcs::ArmState>("_state", "an ArmState"); }
  void do_command_joints(std::span<const double> joints) override { call<void>("_command_joints", "None", joints); }
  bool do_has_arrived() override { return call<bool>("_has_arrived", "a bool"); }
  void do_hold() override { call<void>("_hold", "None"); }
};

struct PyGripper : PyDevice<rcs::Gripper> {
  using PyDevice::PyDevice;
  rcs::GripperState do_state() override { return call<rcs::GripperState>("_state", "a GripperState"); }
  void do_command_opening(double opening) override { call<void>("_command_opening", "None", opening); }
  bool do_has_arrived() override { return call<bool>("_has_arrived", "a bool"); }
  void do_hold() override { call<void>("_hold", "None"); }
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
  nb::class_<rcs::Arm, rcs::Device, PyArm>(
      m, "Arm",
      "One manipulator. Subclasses override `_state`, `_command_joints`, `_has_arrived`, "
      "`_hold` and, where needed, `_open`, `_recover`, `_close`; users call the others.")
      .def(nb::init<std::string, rcs::ArmLimits>(), "name"_a, "limits"_a)
      .def_prop_ro("dof", &rcs::Arm::dof, "Number of joints.")
      .def_prop_ro("limits", &rcs::Arm::limits)
      .def("state", &rcs::Arm::state, WithoutGil(), "Measure joints and velocities.")
      .def(
          "command_joints",
          [](rcs::Arm& arm, const Vector& joints) {
            const std::vector<double> target = to_vector(joints);
            const ReleasedGil released;
            arm.command_joints(target);
          },
          "joints"_a,
          "Set the joint target [rad] and return at once.\n\nRaises InvalidAction for a wrong size, a value that is "
          "not "
          "finite or out of limits,\nWrongOrder when closed, DeviceFault in the fault state; the arm then holds.")
      .def("has_arrived", &rcs::Arm::has_arrived, WithoutGil(),
           "Whether the last target is reached and the arm stands still.")
      .def("hold", &rcs::Arm::hold, WithoutGil(), "Stop where the arm is now. Allowed in the fault state.");

  nb::class_<rcs::GripperState>(m, "GripperState", "What a gripper measures.")
      .def(nb::init<double, double, double>(), "opening"_a, "force"_a, "time"_a)
      .def_ro("opening", &rcs::GripperState::opening, "0 closed … 1 open.")
      .def_ro("force", &rcs::GripperState::force, "Grasping force [N], 0 when not measured.")
      .def_ro("time", &rcs::GripperState::time, "When it was measured [s].");
  nb::class_<rcs::Gripper, rcs::Device, PyGripper>(
      m, "Gripper",
      "One gripper. Subclasses override `_state`, `_command_opening`, `_has_arrived`, "
      "`_hold` and, where needed, `_open`, `_recover`, `_close`.")
      .def(nb::init<std::string, double, double>(), "name"_a, "max_width"_a, "max_force"_a)
      .def_prop_ro("max_width", &rcs::Gripper::max_width, "Opening at 1 [m].")
      .def_prop_ro("max_force", &rcs::Gripper::max_force, "Largest grasping force [N].")
      .def("state", &rcs::Gripper::state, WithoutGil())
      .def("command_opening", &rcs::Gripper::command_opening, WithoutGil(), "opening"_a,
           "Set the opening (0 closed … 1 open) and return at once. Raises as `Arm.command_joints` does.")
      .def("has_arrived", &rcs::Gripper::has_arrived, WithoutGil(),
           "Whether the fingers stand still: at the target, or on an object.")
      .def("hold", &rcs::Gripper::hold, WithoutGil());
}
