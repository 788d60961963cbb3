"""RTDE outputs of a virtual UR, by the names of the vendor's guide."""

from __future__ import annotations

from rcs.virtual.rtde_port import Output
from rcs.virtual.ur_controller import RobotMode, SafetyMode, UrController
from rcs.virtual.ur_motion import vector_of

_SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    SafetyMode.FAULT: 1 << 9 | 1 << 10,
}
_JOINT_RUNNING, _JOINT_FAULT, _JOINT_POWER_OFF = 253, 252, 238


def outputs_of(controller: UrController) -> dict[str, Output]:
    """Return all outputs of a controller; their values are read when they are sent."""
    zeros = [0.0] * 6

    def pose_now() -> list[float]:
        return vector_of(controller.chain.forward(controller.robot.joints)).tolist()

    def target_pose() -> list[float]:
        return vector_of(controller.chain.forward(controller.reference.joints)).tolist()

    def joint_modes() -> list[int]:
        usual = _JOINT_RUNNING if controller.robot_mode == RobotMode.RUNNING else _JOINT_POWER_OFF
        return [_JOINT_FAULT if joint == controller.bad_joint else usual for joint in range(6)]

    def status_bits() -> int:
        return int(controller.robot_mode > RobotMode.POWER_OFF) | int(controller.is_running) << 1

    found = {
        "timestamp": Output("DOUBLE", lambda: controller.clock()),
        "target_q": Output("VECTOR6D", lambda: controller.reference.joints.tolist()),
        "target_qd": Output("VECTOR6D", lambda: controller.reference.velocities.tolist()),
        "actual_q": Output("VECTOR6D", lambda: controller.robot.joints.tolist()),
        "actual_qd": Output("VECTOR6D", lambda: controller.robot.velocities.tolist()),
        "actual_current": Output(
            "VECTOR6D", lambda: (controller.robot.torques / 10.0).tolist()
        ),  # about 10 N·m/A at its joints
        "target_moment": Output("VECTOR6D", lambda: controller.robot.torques.tolist()),
        "actual_TCP_pose": Output("VECTOR6D", pose_now),
        "target_TCP_pose": Output("VECTOR6D", target_pose),
        "robot_mode": Output("INT32", lambda: int(controller.robot_mode)),
        "safety_mode": Output("INT32", lambda: int(controller.safety_mode)),
        "joint_mode": Output("VECTOR6INT32", joint_modes),
        "runtime_state": Output("UINT32", lambda: 2 if controller.is_running else 1),
        "robot_status_bits": Output("UINT32", status_bits),
        "safety_status_bits": Output("UINT32", lambda: _SAFETY_BITS[controller.safety_mode]),
        "payload": Output("DOUBLE", lambda: controller.payload),
    }
    for name in ("target_qdd", "target_current", "joint_control_output", "actual_TCP_speed", "target_TCP_speed",
                 "actual_TCP_force", "joint_temperatures", "actual_joint_voltage", "ft_raw_wrench",
                 "payload_inertia"):  # fmt: skip
        found[name] = Output("VECTOR6D", lambda: zeros)
    for name in ("actual_tool_accelerometer", "payload_cog"):
        found[name] = Output("VECTOR3D", lambda: zeros[:3])
    for name in ("actual_execution_time", "actual_momentum", "standard_analog_input0", "standard_analog_input1",
                 "standard_analog_output0", "standard_analog_output1", "actual_robot_current"):  # fmt: skip
        found[name] = Output("DOUBLE", lambda: 0.0)
    for name in ("speed_scaling", "target_speed_fraction", "speed_scaling_combined"):
        found[name] = Output("DOUBLE", lambda: 1.0)
    for name in ("actual_main_voltage", "actual_robot_voltage"):
        found[name] = Output("DOUBLE", lambda: 48.0)
    for name in ("actual_digital_input_bits", "actual_digital_output_bits"):
        found[name] = Output("UINT64", lambda: 0)
    for index in range(48):
        found[f"output_int_register_{index}"] = Output("INT32", lambda i=index: controller.registers.integers[i])
        found[f"output_double_register_{index}"] = Output("DOUBLE", lambda i=index: controller.registers.doubles[i])
    return found
