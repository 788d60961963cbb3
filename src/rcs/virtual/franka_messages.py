"""The messages of the Franka Control Interface, version 10, and of the Franka Hand, version 3.

Numbers and layouts are those of libfranka-common (Apache-2.0), all little-endian and packed. States use `float32` where
commands use `float64`: libfranka 0.21 silently truncates longer states.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import Pose

ARM_PORT: Final = 1337
HAND_PORT: Final = 1338
ARM_VERSION: Final = 10
HAND_VERSION: Final = 3

ARM_HEADER: Final = np.dtype([("command", "<u4"), ("id", "<u4"), ("size", "<u4")])
HAND_HEADER: Final = np.dtype([("command", "<u2"), ("id", "<u4"), ("size", "<u4")])
"""Header of every message; the size includes the header."""

CONNECT: Final = np.dtype([("version", "<u2"), ("udp_port", "<u2")])
"""Connect request on both ports: the client's version, and the UDP port for states."""


class Command(IntEnum):
    """Requests to an arm."""

    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


class MoveStatus(IntEnum):
    """Answers to a move request: one when the motion starts and one when it ends."""

    SUCCESS = 0
    MOTION_STARTED = 1
    PREEMPTED = 2
    NOT_POSSIBLE = 5
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8
    EMERGENCY_ABORTED = 9
    INPUT_ERROR_ABORTED = 10


class GeneratorMode(IntEnum):
    """Motion generator in an arm's state; a move request numbers it from `JOINT_POSITION` = 0."""

    IDLE = 0
    JOINT_POSITION = 1
    JOINT_VELOCITY = 2
    CARTESIAN_POSITION = 3
    CARTESIAN_VELOCITY = 4
    NONE = 5


class Controller(IntEnum):
    """Source of an arm's torques."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class Mode(IntEnum):
    """Mode of an arm."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


class Error(IntEnum):
    """Errors of an arm, as indices into `errors` and `reflex_reason` of its state."""

    JOINT_POSITION_LIMITS_VIOLATION = 0
    CARTESIAN_POSITION_LIMITS_VIOLATION = 1
    SELF_COLLISION_AVOIDANCE_VIOLATION = 2
    JOINT_VELOCITY_VIOLATION = 3
    CARTESIAN_VELOCITY_VIOLATION = 4
    FORCE_CONTROL_SAFETY_VIOLATION = 5
    JOINT_REFLEX = 6
    CARTESIAN_REFLEX = 7
    MAX_GOAL_POSE_DEVIATION_VIOLATION = 8
    MAX_PATH_POSE_DEVIATION_VIOLATION = 9
    CARTESIAN_VELOCITY_PROFILE_SAFETY_VIOLATION = 10
    JOINT_POSITION_MOTION_GENERATOR_START_POSE_INVALID = 11
    JOINT_MOTION_GENERATOR_POSITION_LIMITS_VIOLATION = 12
    JOINT_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION = 13
    JOINT_MOTION_GENERATOR_VELOCITY_DISCONTINUITY = 14
    JOINT_MOTION_GENERATOR_ACCELERATION_DISCONTINUITY = 15
    CARTESIAN_POSITION_MOTION_GENERATOR_START_POSE_INVALID = 16
    CARTESIAN_MOTION_GENERATOR_ELBOW_LIMIT_VIOLATION = 17
    CARTESIAN_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION = 18
    CARTESIAN_MOTION_GENERATOR_VELOCITY_DISCONTINUITY = 19
    CARTESIAN_MOTION_GENERATOR_ACCELERATION_DISCONTINUITY = 20
    CARTESIAN_MOTION_GENERATOR_ELBOW_SIGN_INCONSISTENT = 21
    CARTESIAN_MOTION_GENERATOR_START_ELBOW_INVALID = 22
    FORCE_CONTROLLER_DESIRED_FORCE_TOLERANCE_VIOLATION = 23
    START_ELBOW_SIGN_INCONSISTENT = 24
    COMMUNICATION_CONSTRAINTS_VIOLATION = 25
    POWER_LIMIT_VIOLATION = 26
    CARTESIAN_MOTION_GENERATOR_JOINT_POSITION_LIMITS_VIOLATION = 27
    CARTESIAN_MOTION_GENERATOR_JOINT_VELOCITY_LIMITS_VIOLATION = 28
    CARTESIAN_MOTION_GENERATOR_JOINT_VELOCITY_DISCONTINUITY = 29
    CARTESIAN_MOTION_GENERATOR_JOINT_ACCELERATION_DISCONTINUITY = 30
    CARTESIAN_POSITION_MOTION_GENERATOR_INVALID_FRAME = 31
    CONTROLLER_TORQUE_DISCONTINUITY = 32
    JOINT_P2P_INSUFFICIENT_TORQUE_FOR_PLANNING = 33
    TAU_J_RANGE_VIOLATION = 34
    INSTABILITY_DETECTED = 35
    JOINT_MOVE_IN_WRONG_DIRECTION = 36
    CARTESIAN_SPLINE_MOTION_GENERATOR_VIOLATION = 37
    JOINT_VIA_MOTION_GENERATOR_PLANNING_JOINT_LIMIT_VIOLATION = 38
    BASE_ACCELERATION_INITIALIZATION_TIMEOUT = 39
    BASE_ACCELERATION_INVALID_READING = 40


ARM_STATE: Final = np.dtype(
    [("message_id", "<u8")]
    + [(name, "<f4", 16) for name in ("O_T_EE", "O_T_EE_d", "F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE")]
    + [("m_ee", "<f4"), ("I_ee", "<f4", 9), ("F_x_Cee", "<f4", 3)]
    + [("m_load", "<f4"), ("I_load", "<f4", 9), ("F_x_Cload", "<f4", 3)]
    + [("elbow", "<f4", 2), ("elbow_d", "<f4", 2)]
    + [(name, "<f4", 7) for name in ("tau_J", "tau_J_d", "dtau_J", "q", "q_d", "dq", "dq_d", "ddq_d")]
    + [("joint_contact", "<f4", 7), ("cartesian_contact", "<f4", 6)]
    + [("joint_collision", "<f4", 7), ("cartesian_collision", "<f4", 6)]
    + [("tau_ext_hat_filtered", "<f4", 7)]
    + [(name, "<f4", 6) for name in ("O_F_ext_hat_K", "K_F_ext_hat_K", "O_dP_EE_d")]
    + [("O_ddP_O", "<f4", 3)]
    + [(name, "<f4", 2) for name in ("elbow_c", "delbow_c", "ddelbow_c")]
    + [("O_T_EE_c", "<f4", 16), ("O_dP_EE_c", "<f4", 6), ("O_ddP_EE_c", "<f4", 6)]
    + [("theta", "<f4", 7), ("dtheta", "<f4", 7)]
    + [("accelerometer_top", "<f4", (6, 3)), ("accelerometer_bottom", "<f4", (6, 3))]
    + [("motion_generator_mode", "u1"), ("controller_mode", "u1")]
    + [("errors", "u1", 41), ("reflex_reason", "u1", 41)]
    + [("robot_mode", "u1"), ("control_command_success_rate", "<f4")]
)
"""State that an arm sends 1000 times a second. Matrices are column-major; a command repeats its state's
`message_id`."""

ARM_COMMAND: Final = np.dtype(
    [("message_id", "<u8"), ("q_c", "<f8", 7), ("dq_c", "<f8", 7), ("O_T_EE_c", "<f8", 16), ("O_dP_EE_c", "<f8", 6)]
    + [("elbow_c", "<f8", 2), ("valid_elbow", "u1"), ("motion_generation_finished", "u1")]
    + [("tau_J_d", "<f8", 7), ("torque_command_finished", "u1")]
)
"""A client's answer to every state while it moves an arm."""

MOVE: Final = np.dtype(
    [("controller_mode", "<u4"), ("motion_generator_mode", "<u4")]
    + [("maximum_path_deviation", "<f8", 3), ("maximum_goal_pose_deviation", "<f8", 3)]
    + [("use_async_motion_generator", "u1"), ("maximum_velocity", "<f8", 7)]
)
COLLISION_BEHAVIOR: Final = np.dtype(
    [
        (f"{bound}_{what}_{when}", "<f8", count)
        for what, count in (("torque", 7), ("force", 6))
        for when in ("acceleration", "nominal")
        for bound in ("lower", "upper")
    ]
)
LOAD: Final = np.dtype([("mass", "<f8"), ("center", "<f8", 3), ("inertia", "<f8", 9)])

REQUESTS: Final[dict[int, np.dtype[np.void]]] = {
    Command.CONNECT: CONNECT,
    Command.MOVE: MOVE,
    Command.SET_COLLISION_BEHAVIOR: COLLISION_BEHAVIOR,
    Command.SET_JOINT_IMPEDANCE: np.dtype([("stiffness", "<f8", 7)]),
    Command.SET_CARTESIAN_IMPEDANCE: np.dtype([("stiffness", "<f8", 6)]),
    Command.SET_GUIDING_MODE: np.dtype([("axes", "u1", 6), ("elbow", "u1")]),
    Command.SET_EE_TO_K: np.dtype([("pose", "<f8", 16)]),
    Command.SET_NE_TO_EE: np.dtype([("pose", "<f8", 16)]),
    Command.SET_LOAD: LOAD,
}
"""Content of requests after the header; requests without an entry have none."""


class HandCommand(IntEnum):
    """Requests to a hand."""

    CONNECT = 0
    HOMING = 1
    GRASP = 2
    MOVE = 3
    STOP = 4


class HandStatus(IntEnum):
    """Answers of a hand."""

    SUCCESS = 0
    FAIL = 1
    UNSUCCESSFUL = 2
    ABORTED = 3


HAND_REQUESTS: Final[dict[int, np.dtype[np.void]]] = {
    HandCommand.CONNECT: CONNECT,
    HandCommand.GRASP: np.dtype([(name, "<f8") for name in ("width", "inner", "outer", "speed", "force")]),
    HandCommand.MOVE: np.dtype([("width", "<f8"), ("speed", "<f8")]),
}
HAND_STATE: Final = np.dtype(
    [("message_id", "<u4"), ("width", "<f8"), ("max_width", "<f8"), ("is_grasped", "u1"), ("temperature", "<u2")]
)
"""State that a hand sends 30 times a second."""


def columns(pose: Pose) -> NDArray[np.float64]:
    """Return the column-major matrix of a pose, shape (16,)."""
    return pose.matrix.T.ravel()
