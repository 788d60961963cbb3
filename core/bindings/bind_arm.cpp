// Arm: the interface of a manipulator.
#include <nanobind/nanobind.h>
#include <nanobind/stl/set.h>
#include <nanobind/stl/vector.h>

#include "overrides.hpp"
#include "rcs/arm.hpp"

using namespace nb::literals;

namespace {

using Values = std::vector<double>;
using Span = std::span<const double>;

struct PyArm : PyDevice<rcs::Arm> {
  using PyDevice::PyDevice;
  rcs::ArmState do_state() override { return call<rcs::ArmState>("_state", "an ArmState"); }
  void do_command_joints(Span joints) override { call<void>("_command_joints", "None", joints); }
  void do_command_pose(const rcs::Pose& pose) override { call<void>("_command_pose", "None", pose); }
  void do_command_twist(Span twist) override { call<void>("_command_twist", "None", twist); }
  void do_command_velocities(Span velocities) override { call<void>("_command_velocities", "None", velocities); }
  void do_command_torques(Span torques) override { call<void>("_command_torques", "None", torques); }
};

}  // namespace

void bind_arm(nb::module_& m) {
  using rcs::Arm, rcs::ArmLimits, rcs::ArmState, rcs::CommandKind;
  nb::enum_<CommandKind>(m, "CommandKind", "Kinds of commands that arms take. Every arm takes joints.")
      .value("joints", CommandKind::joints)
      .value("pose", CommandKind::pose)
      .value("twist", CommandKind::twist)
      .value("velocities", CommandKind::velocities)
      .value("torques", CommandKind::torques);

  nb::class_<ArmLimits> limits(m, "ArmLimits", "Limits of an arm, one value per joint.");
  limits.def(nb::init<Values, Values, Values, Values, Values, Values>(), "joint_lower"_a, "joint_upper"_a,
             "joint_velocity"_a, "joint_acceleration"_a = Values(), "joint_jerk"_a = Values(),
             "joint_effort"_a = Values(),
             "Joint limits [rad], largest velocities [rad/s], accelerations [rad/s²], jerks [rad/s³] and torques "
             "[N·m].\n\nThe last three are empty where they are unknown.");
  def_array(limits, "joint_lower", &ArmLimits::joint_lower, "Lower limits [rad].");
  def_array(limits, "joint_upper", &ArmLimits::joint_upper, "Upper limits [rad].");
  def_array(limits, "joint_velocity", &ArmLimits::joint_velocity, "Largest velocities [rad/s].");
  def_array(limits, "joint_acceleration", &ArmLimits::joint_acceleration, "Largest accelerations [rad/s²], or empty.");
  def_array(limits, "joint_jerk", &ArmLimits::joint_jerk, "Largest jerks [rad/s³], or empty.");
  def_array(limits, "joint_effort", &ArmLimits::joint_effort, "Largest torques [N·m], or empty.");

  nb::class_<ArmState> state(m, "ArmState", "The measurements of an arm.");
  state.def(nb::init<Values, Values, double, double, Values, Values, Values, std::string>(), "joints"_a,
            "joint_velocities"_a, "time"_a = rcs::kNaN, "device_time"_a = rcs::kNaN, "commanded_joints"_a = Values(),
            "efforts"_a = Values(), "wrench"_a = Values(), "mode"_a = "",
            "Leave out what the arm does not measure; without a `time`, `Arm.state` gives it the present one.");
  def_array(state, "joints", &ArmState::joints, "Joint positions [rad].");
  def_array(state, "joint_velocities", &ArmState::joint_velocities, "Joint velocities [rad/s].");
  def_times(state);
  def_array(state, "commanded_joints", &ArmState::commanded_joints,
            "Where the controller wants the joints to be [rad]; empty when unknown.");
  def_array(state, "efforts", &ArmState::efforts, "Torques at the joints [N·m]; empty when not measured.");
  def_array(state, "wrench", &ArmState::wrench,
            "Force and torque on the TCP [N, N·m], (6,), in the frame of the base; empty when not measured.");
  state.def_ro("mode", &ArmState::mode, "The controller's name for what it is doing; may be empty.");

  nb::class_<Arm, rcs::Device, PyArm>(
      m, "Arm",
      "One manipulator. Subclasses override `_state`, `_command_joints`, `_has_arrived`, `_hold` and, where needed, "
      "`_open`,\n`_recover`, `_close`, `_can_guide`, `_guide` and the commands that they name in `more_commands`; "
      "users "
      "call the others.")
      .def(nb::init<std::string, ArmLimits, std::set<CommandKind>>(), "name"_a, "limits"_a,
           "more_commands"_a = std::set<CommandKind>())
      .def_prop_ro("dof", &Arm::dof, "Number of joints.")
      .def_prop_ro("limits", &Arm::limits)
      .def("commands", &Arm::commands, "The kinds of commands that the arm takes.")
      .def("state", &Arm::state, WithoutGil(), "Measure the arm.")
      .def("command_joints", vector_command(&Arm::command_joints), "joints"_a, "valid_for"_a = rcs::kForever,
           "Set the joint target [rad] and return at once.\n\nWithout another command within `valid_for` [s], the arm "
           "holds by itself. Raises InvalidAction for a wrong size, a value\nthat is not finite or out of limits, "
           "WrongOrder when closed or guided, DeviceFault in the fault state; nothing has changed\nthen. So do all "
           "other commands of devices.")
      .def("command_pose", &Arm::command_pose, WithoutGil(), "pose"_a, "valid_for"_a = rcs::kForever,
           "Set the pose of the TCP in the frame of the base.")
      .def("command_twist", vector_command(&Arm::command_twist), "twist"_a, "valid_for"_a = rcs::kForever,
           "Set the velocity of the TCP in the frame of the base [m/s, rad/s], (6,).")
      .def("command_velocities", vector_command(&Arm::command_velocities), "velocities"_a,
           "valid_for"_a = rcs::kForever, "Set the joint velocities [rad/s].")
      .def("command_torques", vector_command(&Arm::command_torques), "torques"_a, "valid_for"_a = rcs::kForever,
           "Set the joint torques besides gravity [N·m].");
}
