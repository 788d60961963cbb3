"""The C++ core of the Robot Control Stack."""

from collections.abc import Callable, Sequence, Set
import enum
from typing import Annotated, Any, Final, Self, overload

import mujoco
import numpy
import numpy.typing
from numpy.typing import NDArray


class Pose:
    """
    A translation [m] and a rotation: the pose of one frame in another, or a rigid motion.

    Immutable and hashable. The quaternion is xyzw, of norm 1, and w is not negative, so equal rotations compare equal.
    Bad numbers raise ValueError: not finite, a quaternion more than 1e-3 off norm 1, a matrix more than 1e-6
    off a rotation.
    """

    def __init__(self, translation: numpy.typing.ArrayLike = (0.0, 0.0, 0.0), quaternion: numpy.typing.ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> None:
        """From a translation [m], shape (3,), and a quaternion xyzw, shape (4,)."""

    @staticmethod
    def from_matrix(matrix: numpy.typing.ArrayLike) -> Pose:
        """From a homogeneous matrix, shape (4, 4)."""

    @staticmethod
    def from_rpy(translation: numpy.typing.ArrayLike, rpy: numpy.typing.ArrayLike) -> Pose:
        """
        From a translation [m] and roll, pitch, yaw [rad] about the fixed x, y, z axes, in that order.
        """

    @staticmethod
    def from_rotvec(translation: numpy.typing.ArrayLike, rotvec: numpy.typing.ArrayLike) -> Pose:
        """
        From a translation [m] and a rotation vector: the axis times the angle [rad].
        """

    @staticmethod
    def from_tquat(tquat: numpy.typing.ArrayLike) -> Pose:
        """From translation [m] and quaternion xyzw in one array, shape (7,)."""

    @staticmethod
    def from_xyzrpy(xyzrpy: numpy.typing.ArrayLike) -> Pose:
        """
        From translation [m] and roll, pitch, yaw [rad] in one array, shape (6,).
        """

    @staticmethod
    def exp(twist: numpy.typing.ArrayLike) -> Pose:
        """
        The motion after one second at a constant twist [v m/s, w rad/s], shape (6,); the inverse of log.
        """

    @property
    def translation(self) -> numpy.typing.NDArray[numpy.float64]:
        """Translation [m], shape (3,)."""

    @property
    def quaternion(self) -> numpy.typing.NDArray[numpy.float64]:
        """Unit quaternion xyzw with w >= 0, shape (4,)."""

    @property
    def rpy(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Roll, pitch, yaw [rad] about the fixed x, y, z axes, shape (3,); roll is 0 where pitch is +-pi/2.
        """

    @property
    def rotvec(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rotation vector: axis times angle [rad], the angle in [0, pi], shape (3,).
        """

    @property
    def matrix(self) -> numpy.typing.NDArray[numpy.float64]:
        """Homogeneous matrix, shape (4, 4)."""

    @property
    def tquat(self) -> numpy.typing.NDArray[numpy.float64]:
        """Translation [m] and quaternion xyzw in one array, shape (7,)."""

    @property
    def xyzrpy(self) -> numpy.typing.NDArray[numpy.float64]:
        """Translation [m] and roll, pitch, yaw [rad] in one array, shape (6,)."""

    def log(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        The twist [v m/s, w rad/s] that reaches this pose from the identity in one second, shape (6,).
        """

    def inverse(self) -> Pose:
        """The pose of A in B from that of B in A."""

    def apply(self, points: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Points given in this frame [m], shape (..., 3), in the frame that this pose is in.
        """

    def interpolate(self, to: Pose, fraction: float) -> Pose:
        """
        The pose a fraction in [0, 1] of the way: straight line and shortest rotation, both at constant speed.
        """

    def angle_to(self, other: Pose) -> float:
        """Angle of the rotation to another pose [rad], in [0, pi]."""

    def distance_to(self, other: Pose) -> float:
        """Distance of the origin to that of another pose [m]."""

    def is_close(self, other: Pose, metres: float, radians: float) -> bool:
        """Whether another pose is within a distance and an angle."""

    def __mul__(self, arg: Pose, /) -> Pose:
        """The pose of C in A from those of B in A and C in B."""

    def __eq__(self, other: object, /) -> bool:
        """Whether every bit is the same."""

    def __hash__(self) -> int: ...

    def __repr__(self) -> str: ...

    def __reduce__(self) -> tuple: ...

def compose_tquat(a: numpy.typing.ArrayLike, b: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Chain poses: those of C in A from those of B in A and C in B.

    Args:
        a: Poses of B in A as tquat, shape (..., 7).
        b: Poses of C in B as tquat, shape (..., 7).
    """

def inverse_tquat(a: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Invert poses: those of A in B from those of B in A.

    Args:
        a: Poses of B in A as tquat, shape (..., 7).
    """

def relative_tquat(a: numpy.typing.ArrayLike, b: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Express poses in the frames of others: inverse(a) composed with b.

    Args:
        a: Poses of the new frames of reference as tquat, shape (..., 7).
        b: Poses given in the same frame as `a`, as tquat, shape (..., 7).
    """

def interpolate_tquat(a: numpy.typing.ArrayLike, b: numpy.typing.ArrayLike, fraction: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Interpolate between poses: straight line and shortest rotation, both at constant speed.

    Args:
        a: Poses at fraction 0 as tquat, shape (..., 7).
        b: Poses at fraction 1 as tquat, shape (..., 7).
        fraction: Fractions in [0, 1], shape (...). Several fractions between two single poses make a path.

    Raises:
        ValueError: A fraction is outside [0, 1].
    """

def limit_step_tquat(start: numpy.typing.ArrayLike, goal: numpy.typing.ArrayLike, max_translation: float, max_rotation: float) -> numpy.typing.NDArray[numpy.float64]:
    """
    Move from start towards goal within limits on translation and on rotation.

    Args:
        start: Poses to start from as tquat, shape (..., 7).
        goal: Poses to reach as tquat, shape (..., 7); returned unchanged if within both limits.
        max_translation: Longest distance from start [m], at least 0; infinity for no limit.
        max_rotation: Largest angle from start [rad], at least 0; infinity for no limit.

    Raises:
        ValueError: A limit is below 0 or NaN.
    """

def distance_tquat(a: numpy.typing.ArrayLike, b: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Measure how far poses are apart: distance of the origins [m] and angle of the rotation [rad], shape (..., 2).

    Args:
        a: Poses as tquat, shape (..., 7).
        b: Poses as tquat, shape (..., 7).
    """

def normalize_tquat(tquat: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Normalize quaternions of any length to norm 1 and w >= 0, for numbers from a policy or file.

    Args:
        tquat: Translations [m] and quaternions xyzw of any length but 0, shape (..., 7).

    Raises:
        ValueError: All components of a quaternion are below 1e-9, so it has no direction.
    """

def tquat_to_xyzrpy(tquat: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Convert quaternions to roll, pitch, yaw: roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].

    Args:
        tquat: Poses, shape (..., 7). If pitch is ±pi/2, roll is chosen as 0.
    """

def xyzrpy_to_tquat(xyzrpy: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Convert roll, pitch, yaw to quaternions.

    Args:
        xyzrpy: Poses, shape (..., 6), with angles of any size.
    """

def tquat_to_matrix(tquat: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Convert poses to homogeneous matrices, shape (..., 4, 4).

    Args:
        tquat: Poses, shape (..., 7).
    """

def matrix_to_tquat(matrix: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Convert homogeneous matrices to poses, shape (..., 7).

    Args:
        matrix: Rotations and translations [m] above the row (0, 0, 0, 1), shape (..., 4, 4).

    Raises:
        ValueError: A matrix is more than 1e-6 off a rotation.
    """

def wxyz_to_xyzw(wxyz: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Reorder quaternions of MuJoCo; the numbers stay as they are.

    Args:
        wxyz: Quaternions with the scalar first, shape (..., 4).
    """

def xyzw_to_wxyz(xyzw: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Reorder quaternions for MuJoCo; the numbers stay as they are.

    Args:
        xyzw: Quaternions with the scalar last, shape (..., 4).
    """

class Device:
    """
    Base class of all devices: a name, a connection, and a fault that stays until `recover`.

    `name`, `is_open`, `is_guided`, `fault`, `hold` and `set_fault` may be used from any thread at any time, also while
    another call is under way. All other calls are for one thread at a time. No call keeps other threads from running. An
    open device stays alive until it is closed; `with device:` opens and closes it.

    An error that a function of a driver raises is the device's fault, in its words, and reaches the caller as DeviceFault.
    Errors of `rcs.errors` pass as they are; a DeviceFault that a driver raises says the fault.

    When the program ends, by SIGTERM, by an exception or without a `close`, every open device that moves holds.
    """

    @property
    def name(self) -> str: ...

    @property
    def is_open(self) -> bool:
        """Whether the device is connected."""

    @property
    def fault(self) -> str:
        """The reason of the fault state, empty when there is none."""

    @property
    def can_guide(self) -> bool:
        """Whether a person can move it by hand."""

    @property
    def is_guided(self) -> bool:
        """Whether a person may move it by hand now."""

    def open(self) -> None:
        """
        Connect, and read what the device is and where.

        Nothing is energised and nothing moves: the first command does that, from the measured state. When it fails, the
        device is closed again. Opening an open device does nothing.
        """

    def hold(self) -> None:
        """
        Stop where the device is now and stay there.

        One that no command has energised stays as it is. Allowed in the fault state.
        """

    def has_arrived(self) -> bool:
        """Whether the last target is reached and the device stands still."""

    def guide(self, on: bool) -> None:
        """
        Let a person move the device by hand, or hold it again.

        While it is guided, commands raise WrongOrder; `hold`, a fault and `close` end it. Raises InvalidAction when the device
        cannot be guided.
        """

    def set_fault(self, reason: str) -> None:
        """
        Enter the fault state and hold: commands are refused until `recover`.

        The first reason stays; if holding fails, the fault says that too, and nothing is raised. A driver that looks for
        faults reads the controller's mode, not its error flags: those may be clear while it still refuses to move.
        """

    def recover(self) -> None:
        """
        Have the device leave its own fault state, hold where it is now, and only then forget the fault.

        Raises DeviceFault if one of these fails or a new fault comes meanwhile; the device is then in the fault state.
        """

    def close(self) -> None:
        """
        Hold and let go of the device. Closing twice is harmless.

        A failure is a fault and is raised when all is done; nothing is raised in the fault state, which is known.
        """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

def stop_all(reason: str) -> None:
    """
    Have every open device of this process that moves enter its fault state and hold, all at once.

    From any thread, but not from inside of a `_hold`. All refuse commands before the first one is held.
    """

class CommandKind(enum.Enum):
    """Kinds of commands that arms take. Every arm takes joints."""

    joints = 0

    pose = 1

    twist = 2

    velocities = 3

    torques = 4

class ArmLimits:
    """Limits of an arm, one value per joint."""

    def __init__(self, joint_lower: Sequence[float], joint_upper: Sequence[float], joint_velocity: Sequence[float], joint_acceleration: Sequence[float] = [], joint_jerk: Sequence[float] = [], joint_effort: Sequence[float] = []) -> None:
        """
        Joint limits [rad], largest velocities [rad/s], accelerations [rad/s²], jerks [rad/s³] and torques [N·m].

        The last three are empty where they are unknown.
        """

    @property
    def joint_lower(self) -> NDArray[numpy.float64]:
        """Lower limits [rad]."""

    @property
    def joint_upper(self) -> NDArray[numpy.float64]:
        """Upper limits [rad]."""

    @property
    def joint_velocity(self) -> NDArray[numpy.float64]:
        """Largest velocities [rad/s]."""

    @property
    def joint_acceleration(self) -> NDArray[numpy.float64]:
        """Largest accelerations [rad/s²], or empty."""

    @property
    def joint_jerk(self) -> NDArray[numpy.float64]:
        """Largest jerks [rad/s³], or empty."""

    @property
    def joint_effort(self) -> NDArray[numpy.float64]:
        """Largest torques [N·m], or empty."""

class ArmState:
    """The measurements of an arm."""

    def __init__(self, joints: Sequence[float], joint_velocities: Sequence[float], time: float = float('nan'), device_time: float = float('nan'), commanded_joints: Sequence[float] = [], efforts: Sequence[float] = [], wrench: Sequence[float] = [], mode: str = '') -> None:
        """
        Leave out what the arm does not measure; without a `time`, `Arm.state` gives it the present one.
        """

    @property
    def joints(self) -> NDArray[numpy.float64]:
        """Joint positions [rad]."""

    @property
    def joint_velocities(self) -> NDArray[numpy.float64]:
        """Joint velocities [rad/s]."""

    @property
    def time(self) -> float:
        """
        When it was measured [s], on the host's clock that `time.monotonic` reads.
        """

    @property
    def device_time(self) -> float:
        """The same on the device's own clock [s]; NaN when it has none."""

    @property
    def commanded_joints(self) -> NDArray[numpy.float64]:
        """Where the controller wants the joints to be [rad]; empty when unknown."""

    @property
    def efforts(self) -> NDArray[numpy.float64]:
        """Torques at the joints [N·m]; empty when not measured."""

    @property
    def wrench(self) -> NDArray[numpy.float64]:
        """
        Force and torque on the TCP [N, N·m], (6,), in the frame of the base; empty when not measured.
        """

    @property
    def mode(self) -> str:
        """The controller's name for what it is doing; may be empty."""

class Arm(Device):
    """
    One manipulator. Subclasses override `_state`, `_command_joints`, `_has_arrived`, `_hold` and, where needed, `_open`,
    `_recover`, `_close`, `_can_guide`, `_guide` and the commands that they name in `more_commands`; users call the others.
    """

    def __init__(self, name: str, limits: ArmLimits, more_commands: Set[CommandKind] = ...) -> None: ...

    @property
    def dof(self) -> int:
        """Number of joints."""

    @property
    def limits(self) -> ArmLimits: ...

    def commands(self) -> set[CommandKind]:
        """The kinds of commands that the arm takes."""

    def state(self) -> ArmState:
        """Measure the arm."""

    def command_joints(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], valid_for: float = float('inf')) -> None:
        """
        Set the joint target [rad] and return at once.

        Without another command within `valid_for` [s], the arm holds by itself. Raises InvalidAction for a wrong size, a value
        that is not finite or out of limits, WrongOrder when closed or guided, DeviceFault in the fault state; nothing has changed
        then. So do all other commands of devices.
        """

    def command_pose(self, pose: Pose, valid_for: float = float('inf')) -> None:
        """Set the pose of the TCP in the frame of the base."""

    def command_twist(self, twist: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], valid_for: float = float('inf')) -> None:
        """
        Set the velocity of the TCP in the frame of the base [m/s, rad/s], (6,).
        """

    def command_velocities(self, velocities: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], valid_for: float = float('inf')) -> None:
        """Set the joint velocities [rad/s]."""

    def command_torques(self, torques: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], valid_for: float = float('inf')) -> None:
        """Set the joint torques besides gravity [N·m]."""

class GripperState:
    """The measurements of a gripper."""

    def __init__(self, opening: float, force: float = float('nan'), time: float = float('nan'), device_time: float = float('nan')) -> None: ...

    @property
    def opening(self) -> float:
        """0 closed … 1 open."""

    @property
    def force(self) -> float:
        """Grasping force [N], NaN when not measured."""

    @property
    def time(self) -> float:
        """
        When it was measured [s], on the host's clock that `time.monotonic` reads.
        """

    @property
    def device_time(self) -> float:
        """The same on the device's own clock [s]; NaN when it has none."""

class Gripper(Device):
    """
    One gripper. Subclasses override `_state`, `_command_opening`, `_has_arrived`, `_hold` and, where needed, `_open`,
    `_recover`, `_close`, `_can_guide`, `_guide`.
    """

    def __init__(self, name: str, max_width: float, max_force: float) -> None: ...

    @property
    def max_width(self) -> float:
        """Opening at 1 [m]."""

    @property
    def max_force(self) -> float:
        """Largest grasping force [N]."""

    def state(self) -> GripperState:
        """Measure the gripper."""

    def command_opening(self, opening: float, force: float | None = None, valid_for: float = float('inf')) -> None:
        """
        Set the opening (0 closed … 1 open) and, where given, the grasping force [N]; ends and raises as `Arm.command_joints`.

        It has arrived when the fingers stand still: at the target, or on an object.
        """

class HandState:
    """The measurements of a hand."""

    def __init__(self, joints: Sequence[float], time: float = float('nan'), device_time: float = float('nan')) -> None: ...

    @property
    def joints(self) -> NDArray[numpy.float64]:
        """Normalised joints, 0 … 1."""

    @property
    def time(self) -> float:
        """
        When it was measured [s], on the host's clock that `time.monotonic` reads.
        """

    @property
    def device_time(self) -> float:
        """The same on the device's own clock [s]; NaN when it has none."""

class Hand(Device):
    """
    One multi-fingered hand. Subclasses override `_state`, `_command_joints`, `_has_arrived`, `_hold` and, where needed,
    `_open`, `_recover`, `_close`, `_can_guide`, `_guide`.
    """

    def __init__(self, name: str, joint_count: int) -> None: ...

    @property
    def joint_count(self) -> int: ...

    def state(self) -> HandState:
        """Measure the hand."""

    def command_joints(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], valid_for: float = float('inf')) -> None:
        """
        Set every joint (normalised, 0 … 1); ends and raises as `Arm.command_joints`.
        """

class CameraMode:
    """Mode of a camera: what it delivers, and at what size."""

    def __init__(self, width: int, height: int, fps: float, has_depth: bool = False) -> None: ...

    @property
    def width(self) -> int:
        """Pixels."""

    @property
    def height(self) -> int:
        """Pixels."""

    @property
    def fps(self) -> float:
        """Frames per second."""

    @property
    def has_depth(self) -> bool: ...

class CameraCalibration:
    """How a camera maps directions to pixels."""

    def __init__(self, matrix: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], distortion: Sequence[float] = []) -> None: ...

    @property
    def matrix(self) -> NDArray[numpy.float64]:
        """
        Camera matrix K [px], (3, 3); the centre of the top left pixel is (0, 0), as in OpenCV.
        """

    @property
    def distortion(self) -> NDArray[numpy.float64]:
        """OpenCV's distortion coefficients, (n,); empty without distortion."""

class Frame:
    """
    One picture. Its arrays are read-only views of memory that all copies share.
    """

    def __init__(self, rgb: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, 3), order='C', device='cpu', writable=False)], depth_mm: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu', writable=False)] | None = None, *, number: int, time: float = float('nan'), device_time: float = float('nan')) -> None:
        """
        Make a frame of rgb (H, W, 3) uint8 and depth [mm] (H, W) uint16 or None.

        It keeps the arrays and does not copy them: write to them no more. `number` counts the frames of the device: a camera whose
        number stands still stalls. Without a `time`, `Camera.read` gives it that of the first read of its number.
        """

    @property
    def rgb(self) -> Annotated[NDArray[numpy.uint8], dict(writable=False)]:
        """Colours, (H, W, 3) uint8, rows from the top, read-only."""

    @property
    def depth_mm(self) -> Annotated[NDArray[numpy.uint16], dict(writable=False)] | None:
        """
        Depth [mm], (H, W) uint16, 0 = no reading, read-only; None without depth.
        """

    @property
    def number(self) -> int:
        """Counts frames of the device."""

    @property
    def time(self) -> float:
        """
        When it was measured [s], on the host's clock that `time.monotonic` reads.
        """

    @property
    def device_time(self) -> float:
        """The same on the device's own clock [s]; NaN when it has none."""

class Camera(Device):
    """
    One camera. Subclasses override `_read` and, where needed, `_calibration`, `_open`, `_recover`, `_close`.
    """

    def __init__(self, name: str, mode: CameraMode) -> None: ...

    @property
    def mode(self) -> CameraMode: ...

    @property
    def calibration(self) -> CameraCalibration | None:
        """
        Matrix and distortion; None when they are unknown, which may be so until the camera is open.
        """

    def read(self) -> Frame:
        """
        The newest frame. Raises DeviceFault when its size is not that of the mode, and when its time is ahead of the
        host's monotonic clock by more than 0.1 s.
        """

class HostedArm(Arm):
    """An arm whose driver runs in a process of its own."""

    def __init__(self, like: Arm, connect: Callable[[], tuple[int, int, int]], answer: float) -> None:
        """
        Be as `like`, a device of the driver that is never opened.

        `connect` starts a host where needed, opens the device there, and returns a file of shared memory, one of a socket, and
        the number of the host's process. `answer` is how long the host may take to hold [s].
        """

    @property
    def host(self) -> int:
        """The number of the process of the host, or 0 where there is none."""

    @property
    def is_streamed(self) -> bool:
        """
        Whether it is a `StreamedArm` there. Only such an arm has `period` and `clamped`.
        """

    @property
    def period(self) -> float:
        """
        Time between commands [s], for which they are planned. Set it before the first one.
        """

    @period.setter
    def period(self, arg: float, /) -> None: ...

    def clamped(self) -> dict[str, int]:
        """
        How many commands since `open` asked for more than is allowed, by what was too much, as last measured.
        """

class HostedGripper(Gripper):
    """A gripper whose driver runs in a process of its own."""

    def __init__(self, like: Gripper, connect: Callable[[], tuple[int, int, int]], answer: float) -> None:
        """
        Be as `like`, a device of the driver that is never opened.

        `connect` starts a host where needed, opens the device there, and returns a file of shared memory, one of a socket, and
        the number of the host's process. `answer` is how long the host may take to hold [s].
        """

    @property
    def host(self) -> int:
        """The number of the process of the host, or 0 where there is none."""

class HostedHand(Hand):
    """A hand whose driver runs in a process of its own."""

    def __init__(self, like: Hand, connect: Callable[[], tuple[int, int, int]], answer: float) -> None:
        """
        Be as `like`, a device of the driver that is never opened.

        `connect` starts a host where needed, opens the device there, and returns a file of shared memory, one of a socket, and
        the number of the host's process. `answer` is how long the host may take to hold [s].
        """

    @property
    def host(self) -> int:
        """The number of the process of the host, or 0 where there is none."""

class HostCall(enum.Enum):
    """Requests of a program to the host of a device."""

    joints = 0

    pose = 1

    twist = 2

    velocities = 3

    torques = 4

    opening = 5

    has_arrived = 6

    guide = 7

    recover = 8

    close = 9

class HostOutcome(enum.Enum):
    """How a call ended in the host."""

    done = 0

    invalid = 1

    wrong_order = 2

    fault = 3

class HostRequest:
    """One call that the program asks for."""

    @property
    def call(self) -> HostCall: ...

    @property
    def values(self) -> NDArray[numpy.float64]: ...

    @property
    def valid_for(self) -> float:
        """Remaining time of a command [s]."""

    @property
    def force(self) -> float | None:
        """Grasping force [N], or None."""

    @property
    def period(self) -> float:
        """Time between commands to a streamed arm [s]; 0 for the usual one."""

    @property
    def is_void(self) -> bool:
        """Whether the device was held after the program asked."""

class HostDesk:
    """
    Where one device of a host is served: requests of the program come in, measurements and answers go out.

    A thread holds the device when the program says so, ends or stands still.
    """

    def __init__(self, memory: int, socket: int, program: int, device: Device) -> None:
        """
        `program` is the number of its process; the files stay those of the caller.
        """

    @property
    def is_used(self) -> bool:
        """Whether the program is still there."""

    def promise(self, under_way: str, seconds: float) -> None:
        """
        Say what is done from now on, and that there is a sign after `seconds` at the latest.
        """

    def next(self, seconds: float) -> HostRequest | None:
        """
        The next request, or None after `seconds` or when the program has ended.
        """

    def answer(self, request: HostRequest, outcome: HostOutcome, text: str = '', flag: bool = False) -> None:
        """
        Report how a request ended. If the device was held meanwhile, it is held again first.
        """

    @overload
    def show(self, state: ArmState) -> None:
        """Hand out a measurement."""

    @overload
    def show(self, state: GripperState) -> None: ...

    @overload
    def show(self, state: HandState) -> None: ...

    def show_failure(self, reason: str) -> None:
        """Say why there is no newer measurement."""

HOST_MEMORY: int = 4472

INTERFACE_VERSION: int = 5

class IkStatus(enum.Enum):
    """The outcome of inverse kinematics."""

    ok = 0
    """The target is reached within the tolerances."""

    clamped = 1
    """
    The target is farther away than allowed, the answer is the allowed step towards it.
    """

    infeasible = 2
    """No solution inside the joint limits; the answer is the start."""

    nearest = 3
    """
    With best effort: no solution near the start, the answer is the nearest pose inside the joint limits.
    """

class IkOptions:
    """How hard inverse kinematics tries, and what it may answer."""

    def __init__(self, *, translation_tolerance: float = 0.0001, rotation_tolerance: float = 0.0001, iterations: int = 30, restarts: int = 60, damping: float = 0.0001, rotation_weight: float = 1.0, max_step: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, preferred: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, preferred_weight: float = 2.0, best_effort: bool = False, seed: int = 0) -> None: ...

    @property
    def translation_tolerance(self) -> float:
        """m"""

    @property
    def rotation_tolerance(self) -> float:
        """rad"""

    @property
    def iterations(self) -> int:
        """Per attempt."""

    @property
    def restarts(self) -> int:
        """
        Further attempts from random joints; 0 keeps to the branch of the start.
        """

    @property
    def damping(self) -> float:
        """Damping of the least squares."""

    @property
    def rotation_weight(self) -> float:
        """
        How much a radian counts against a metre; below 1 the rotation gives way to the translation.
        """

    @property
    def max_step(self) -> NDArray[numpy.float64]:
        """
        Largest change of each joint from the start [rad], shape (dof,), or (0,) for no bound. A solution farther away is clamped: all joints go the same share of the way towards it.
        """

    @property
    def preferred(self) -> NDArray[numpy.float64]:
        """
        Joints [rad] that an arm with more joints than it needs returns to without moving its TCP, shape (dof,), or (0,) for none.
        """

    @property
    def preferred_weight(self) -> float:
        """
        How strongly it is drawn there: share of the way back per radian that the fastest joint moves for the TCP. It depends on the path alone; a TCP at rest means an arm at rest.
        """

    @property
    def best_effort(self) -> bool:
        """
        Follow the target: out of reach, answer with the `nearest` pose instead of the start, and beyond `max_step` with a step in the direction of the target. Everything that the target leaves unchanged is kept: a push against the end of the reach does not turn the tool, and a turn against a joint's limit does not move it. A joint that starts outside its limits goes no farther out, and need not come back.
        """

    @property
    def seed(self) -> int:
        """Seed of the restarts; the same seed gives the same answer."""

class VelocityOptions:
    """How joints may move for a twist of the TCP."""

    def __init__(self, *, max_velocity: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, preferred: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, preferred_weight: float = 2.0, damping: float = 0.03) -> None: ...

    @property
    def max_velocity(self) -> NDArray[numpy.float64]:
        """
        Largest speed of each joint [rad/s], shape (dof,), or (0,) for no bound. All joints are slowed down alike, so that the TCP keeps its direction.
        """

    @property
    def preferred(self) -> NDArray[numpy.float64]:
        """
        As in IkOptions: joints [rad] that an arm with more joints than it needs returns to, shape (dof,) or (0,).
        """

    @property
    def preferred_weight(self) -> float:
        """As in IkOptions."""

    @property
    def damping(self) -> float:
        """
        How near a singular posture joints are slowed down [m/rad]: where the TCP moves by less than this when the joints move by one radian, in the direction in which it does. No more than 1 / damping rad/s answer to 1 m/s.
        """

class Velocities:
    """Joint velocities for a twist."""

    @property
    def joints(self) -> NDArray[numpy.float64]:
        """rad/s, shape (dof,)."""

    @property
    def status(self) -> IkStatus:
        """
        `clamped`: slower, the same way; `nearest`: the TCP moves otherwise than asked.
        """

    @property
    def share(self) -> float:
        """
        Share of the speed, 0 to 1; below 1 where a joint is as fast as it may be.
        """

    @property
    def translation_error(self) -> float:
        """m/s, between what is asked, at this share, and what the joints do."""

    @property
    def rotation_error(self) -> float:
        """rad/s, likewise."""

class IkResult:
    """The answer of inverse kinematics."""

    def __init__(self, joints: Sequence[float], status: IkStatus, translation_error: float = 0.0, rotation_error: float = 0.0, iterations: int = 0) -> None: ...

    @property
    def joints(self) -> NDArray[numpy.float64]:
        """
        Inside the limits [rad]; of a joint that was outside at the start of a motion, no farther out than there.
        """

    @property
    def status(self) -> IkStatus: ...

    @property
    def translation_error(self) -> float:
        """m, before any clamping."""

    @property
    def rotation_error(self) -> float:
        """rad, before any clamping."""

    @property
    def iterations(self) -> int: ...

class Kinematics:
    """
    Kinematics of one arm: TCP pose in the base frame from joints, and back. Subclasses override `_dof`, `_joint_lower`, `_joint_upper` and `_forward(joints)`; where they have a better one than finite differences, `_jacobian(joints)`, and than damped least squares, `_inverse(target, start, options)`.
    """

    def __init__(self) -> None: ...

    @property
    def dof(self) -> int: ...

    @property
    def joint_lower(self) -> NDArray[numpy.float64]:
        """rad"""

    @property
    def joint_upper(self) -> NDArray[numpy.float64]:
        """rad"""

    def forward(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Pose:
        """Pose of the TCP in the base frame for joints [rad], shape (dof,)."""

    def inverse(self, target: Pose, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], options: IkOptions = ...) -> IkResult:
        """
        Joints [rad] that bring the TCP to `target` (in the base frame), looked for from `start`, shape (dof,).
        """

    def jacobian(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        Jacobian of the TCP in the base frame, (6, dof): translation [m/rad] above rotation [rad/rad].
        """

    def forward_batch(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        TCP poses (N, 7) in the base frame for joints (N, dof): translation [m], quaternion xyzw.
        """

    def inverse_batch(self, targets: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], starts: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], options: IkOptions = ..., threads: int = 1) -> tuple:
        """
        Solve for targets (N, 7) from starts (N, dof).

        Returns joints (N, dof), IkStatus values (N,) uint8, and what is left of translation [m] and rotation [rad], (N, 2). The GIL is released. Kinematics in Python take the rows one by one in the thread of the caller.
        """

    def velocities(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], twist: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], options: VelocityOptions = ...) -> Velocities:
        """
        Joint velocities [rad/s] at joints (dof,) that move the TCP at a twist (6,): linear [m/s] and angular velocity [rad/s] in the base frame.
        """

    def advance(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], twist: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], duration: float, options: VelocityOptions = ...) -> IkResult:
        """
        Joints after the TCP has moved from joints (dof,) at a twist (6,) for `duration` [s]: along a straight line, turning about one axis.

        The errors are what the TCP's pose lacks of it. `clamped`: it went slower, the same way, since a joint is as fast as it may be; `nearest`: a singular posture or a joint's limit made it go another way. Joints that start outside their limits go no farther out. Zero twist leaves all as they are.
        """

    def advance_batch(self, joints: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], twists: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], duration: float, options: VelocityOptions = ..., threads: int = 1) -> tuple:
        """
        Advance many, joints (N, dof) at twists (N, 6).

        Returns what `inverse_batch` does.
        """

class DampedLeastSquares(Kinematics):
    """
    Damped least squares on a chain of hinges and slides, with the joint limits inside the solve. Several threads may use one solver at once.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[int], tcp_site: int, base_body: int) -> None:
        """
        Take the chain out of a model; the ids of joints (base to tip), TCP site and base body are its. The model is not kept.
        """

class StreamPoint:
    """Where the joints are to be at one tick."""

    @property
    def position(self) -> NDArray[numpy.float64]:
        """Joint positions [rad]."""

    @property
    def velocity(self) -> NDArray[numpy.float64]:
        """Joint velocities [rad/s]."""

    @property
    def acceleration(self) -> NDArray[numpy.float64]:
        """Joint accelerations [rad/s²]."""

class TcpBox:
    """Where the TCP may be, in the frame of the base."""

    def __init__(self, lower: Sequence[float], upper: Sequence[float], kinematics: Kinematics) -> None:
        """
        Bounds [m]. The kinematics are asked several times per tick: those that are written in Python make ticks late.
        """

class StreamOptions:
    """How an arm is streamed to."""

    def __init__(self, *, rate: float = 1000.0, period: float = 0.03333333333333333, is_paced_by_read: bool = False, margin: float = 0.0, first_step: float = 0.2, tracking_error: float = 0.3, arrival: float = 0.01, silence: float = 0.25, missed_ticks: int = 20, box: TcpBox | None = None, more_commands: Set[CommandKind] = ...) -> None:
        """
        Points per second, and the time between commands [s].

        With `is_paced_by_read`, `_read` returns once per tick and is waited for. Targets keep the `margin` [rad] from the ends of
        the joints' ranges; the first one is within `first_step` [rad] of the measured joints. A joint that is farther than
        `tracking_error` [rad] from where it is led, calls that do not return for longer than `silence` [s] and more than
        `missed_ticks` in a row are faults. A joint has arrived within `arrival` [rad]. `more_commands` are what the arm takes besides joints.
        """

    @property
    def rate(self) -> float: ...

    @property
    def period(self) -> float: ...

    @property
    def is_paced_by_read(self) -> bool: ...

    @property
    def margin(self) -> float: ...

    @property
    def first_step(self) -> float: ...

    @property
    def tracking_error(self) -> float: ...

    @property
    def arrival(self) -> float: ...

    @property
    def silence(self) -> float: ...

    @property
    def missed_ticks(self) -> int: ...

class StreamedArm(Arm):
    """
    An arm that a thread leads from command to command, at the arm's rate, along the trajectory of a simulated one.

    Subclasses override `_read`, `_write`, `_stop` and, where needed, `_open`, `_start`, `_clear`, `_guide` with `_can_guide`,
    and `_close`; users call what every `Arm` has. `open` connects and reads; the first command, which must be near the
    measured joints, starts the arm. From then on each tick writes a point, within the limits of position, speed,
    acceleration and jerk. A command whose time is over, `hold` and faults from outside brake the arm within these limits,
    and it is led where it stands. Errors of `_read` or `_write`, a joint that is not where it is led, and too many missed
    ticks are faults that call `_stop` at once; after `recover`, the next command starts the arm again. An arm that names `more_commands` overrides
    `_write_other(kind, values)` and `_brake_other`; the controller keeps the limits then.

    All of the vendor's functions run on the arm's thread but `_open`, `_close` and, while another one does not return, `_stop`.
    """

    def __init__(self, name: str, limits: ArmLimits, options: StreamOptions = ...) -> None:
        """
        Raises InvalidSetup where the limits lack acceleration or jerk, or an option makes no sense.
        """

    @property
    def options(self) -> StreamOptions: ...

    @property
    def period(self) -> float:
        """
        Time between commands [s], for which they are planned. Set it before the first one.
        """

    @period.setter
    def period(self, arg: float, /) -> None: ...

    def clamped(self) -> dict[str, int]:
        """
        How many commands since `open` asked for more than is allowed, by what was too much.
        """

    @property
    def ticks(self) -> int:
        """Points written since `open`."""

    @property
    def missed_ticks(self) -> int:
        """Ticks left out because the thread came too late."""

    @property
    def lapses(self) -> int:
        """Commands whose time was over before the next one."""

    @property
    def real_time_advice(self) -> str:
        """
        The obstacle to running the thread in real time and the line that mends it; may be empty.
        """

class Clearance:
    """How near robots are to what they must not touch."""

    @property
    def distance(self) -> float:
        """m, negative inside each other; at most the margin."""

    @property
    def geoms(self) -> tuple[int, int]:
        """
        Ids of the nearest pair in the model; (-1, -1) when none is nearer than the margin.
        """

class Hit:
    """Where a joint motion first comes too near."""

    @property
    def fraction(self) -> float:
        """Fraction of the motion, 0 to 1, at which a pair was found too near."""

    @property
    def free_until(self) -> float:
        """
        Fraction up to which no pair was too near; 0 when the motion starts so.
        """

    @property
    def distance(self) -> float:
        """Distance of the pair at `fraction` [m]."""

    @property
    def geoms(self) -> tuple[int, int]:
        """Ids of the pair in the model."""

class CollisionChecker:
    """
    Distances and contacts of robots in a scene of MuJoCo, at given joints and along straight joint motions.

    The geometry that takes part is everything that the joints move: links, end effectors, mounted cameras, attached objects. It is checked against itself and against everything else, as far as MuJoCo would let the two touch and the pair is not allowed. Geoms that no joint moves relative to each other are not checked. Soft bodies take no part. Several threads may use one checker at once; what changes the scene changes it for later calls.
    """

    def __init__(self, model: mujoco.MjModel, robots: Sequence[Sequence[int]]) -> None:
        """
        Copy a model; `robots` are the joint ids of each robot, hinges and slides with limits.

        Raises InvalidSetup when a joint is not in the model, or no geometry takes part that could touch anything.
        """

    @property
    def dof(self) -> int:
        """Number of joints of all robots."""

    @property
    def joints(self) -> list[int]:
        """Joint ids in the order of every vector of joints."""

    @property
    def joint_lower(self) -> NDArray[numpy.float64]:
        """rad or m"""

    @property
    def joint_upper(self) -> NDArray[numpy.float64]:
        """rad or m"""

    @property
    def pairs(self) -> NDArray[numpy.int32]:
        """Ids of the geoms that are checked against each other, (pairs, 2)."""

    def describe(self, geom: int) -> str:
        """A geom in words, such as "geom 'shelf' of body 'rack'"."""

    def set_state(self, qpos: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], mocap_pos: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, mocap_quat: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Say where everything else is: `qpos` (nq,), and mocap bodies' positions (3 * nmocap,) and quaternions wxyz (4 * nmocap,), None to leave them.

        The robots' own entries only say where they were when something is attached.
        """

    def allow(self, a: str, b: str) -> int:
        """
        Let two things touch: all geoms of a body, or one geom, by name on each side. Returns how many pairs this drops.
        """

    def attach(self, body: int, to: int, pose_in_to: Pose | None = None) -> None:
        """
        Let a body with a free joint, or a mocap body, move with the body `to` (ids), from where both are in the present state or at `pose_in_to`. It may then touch what moves with `to` alone.
        """

    def detach(self, body: int) -> None:
        """Leave an attached body where the state has it."""

    def clearance(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], margin: float) -> Clearance:
        """Smallest distance at joints `q` (dof,) [rad], if below `margin` [m]."""

    def is_free(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], margin: float = 0.0) -> bool:
        """
        Whether no pair is nearer than `margin` [m] at joints `q` (dof,) [rad].
        """

    def first_hit(self, q_from: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], q_to: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], step: float = 0.002, turn: float = 0.0087, margin: float = 0.0) -> Hit | None:
        """
        First place on the straight joint motion (dof,) -> (dof,) [rad] where a pair is nearer than `margin` [m]; None when it is free.

        Between two checks of a pair that is near, no point of a robot moves by more than `step` [m] and nothing turns by more than `turn` [rad]; larger strides are made only where the distance proves them free. Contact deeper than half a step is never missed, and with a margin of at least half a step no contact is. The GIL is released.
        """

    def first_hit_on_way(self, places: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], step: float = 0.002, turn: float = 0.0087, margin: float = 0.0, bend: float = 0.001) -> Hit | None:
        """
        `first_hit` on a way of many places (N, dof), from each to the next; fractions are of the number of places. Neighbours that lie on one straight motion to within `bend` [rad] are swept together.
        """

    def clearance_rows(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], margin: float, threads: int = 1) -> tuple:
        """
        `clearance` of rows (N, dof): distances (N,) [m] and geoms (N, 2). The GIL is released.
        """

    def free_rows(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], margin: float = 0.0, threads: int = 1) -> NDArray[numpy.bool_]:
        """`is_free` of rows (N, dof): flags (N,). The GIL is released."""

    def first_hit_rows(self, q_from: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], q_to: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], step: float = 0.002, turn: float = 0.0087, margin: float = 0.0, threads: int = 1) -> tuple:
        """
        `first_hit` of rows (N, dof): fractions (N,), infinite for a free motion; `free_until` (N,); geoms (N, 2). The GIL is released.
        """

class LineProfile:
    """
    The quickest motion along a line over a distance from speed to speed, at limited acceleration and jerk, without acceleration at either end (Ruckig).
    """

    def __init__(self, distance: float, from_speed: float, to_speed: float, velocity: float, acceleration: float, jerk: float) -> None:
        """
        Plan it; the unit of all numbers is that of the distance, and seconds.

        Raises InvalidSetup for limits that are not positive, speeds outside 0 to `velocity`, or a distance too short to get from speed to speed.
        """

    @property
    def duration(self) -> float:
        """s"""

    def at(self, times: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        Way, velocity, acceleration and jerk, (N, 4), at times (N,) [s] after the start; before and after, those of the ends.
        """

    @staticmethod
    def fastest(from_speed: float, distance: float, velocity: float, acceleration: float, jerk: float) -> float:
        """
        The highest speed up to `velocity` that can be reached from a speed over a distance.
        """

class StepView:
    """
    One copy of a scene while it is stepped; afterwards, using it raises WrongOrder. Arrays are views of MuJoCo's own memory and have meaning only during the call.
    """

    @property
    def copy(self) -> int:
        """Which copy this is."""

    @property
    def time(self) -> float:
        """Simulated time [s]."""

    @property
    def qpos(self) -> NDArray[numpy.float64]: ...

    @property
    def qvel(self) -> NDArray[numpy.float64]: ...

    @property
    def ctrl(self) -> NDArray[numpy.float64]: ...

    @property
    def xpos(self) -> NDArray[numpy.float64]: ...

    @property
    def site_xpos(self) -> NDArray[numpy.float64]: ...

    @property
    def qfrc_applied(self) -> NDArray[numpy.float64]: ...

    @property
    def xfrc_applied(self) -> NDArray[numpy.float64]: ...

    @property
    def contacts(self) -> int:
        """Number of contacts."""

    @property
    def model_address(self) -> int: ...

    @property
    def data_address(self) -> int: ...

class StepCallback:
    """
    A function run between physics steps. Subclasses override `call(view) -> bool` and, where they remember something per copy, `reset(copy)`. Copies are stepped on several threads.
    """

    def __init__(self) -> None: ...

    def reset(self, copy: int) -> None:
        """Forget what was remembered of a copy; its episode starts anew."""

class JointsArrived(StepCallback):
    """True when position-controlled joints stand at their targets."""

    def __init__(self, joints: Sequence[int], actuators: Sequence[int], position_tolerance: float, velocity_tolerance: float) -> None:
        """Tolerances in rad (or m) and rad/s (or m/s)."""

class JointsAtRest(StepCallback):
    """True when joints have stood still for a while."""

    def __init__(self, joints: Sequence[int], velocity_tolerance: float, duration: float, copies: int, within_step: bool = False) -> None:
        """
        Tolerance in rad/s (or m/s), duration in s. With `within_step`, rest counts from the step's beginning.
        """

class Collision(StepCallback):
    """
    True when a surface of one set touches one of the other with more than a force.
    """

    def __init__(self, first: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], second: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], force: float) -> None:
        """
        One uint8 flag per geom of the model, then one per flex, for each set; force in N.
        """

class MotionLimits:
    """Limits of a motion, one value per joint."""

    def __init__(self, lower: Sequence[float], upper: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float], jerk: Sequence[float]) -> None:
        """Positions in rad, then rad/s, rad/s^2 and rad/s^3."""

    def lead(self, period: float) -> list[float]:
        """
        How far a target may lead each joint [rad], when targets come every `period` [s].
        """

class Trajectory:
    """
    The law of motion of an arm, in memory of the caller: what its joints do between one target and the next. The first `dof` numbers of the memory are the target [rad].
    """

    def __init__(self, limits: MotionLimits) -> None: ...

    @staticmethod
    def size(dof: int) -> int:
        """Numbers that so many joints take."""

    POSITION_ROWS: Final[list[int]] = ...
    """
    Rows of `dof` numbers that are joint positions; where the arm stands still, all are equal and the rest is 0.
    """

    @property
    def dof(self) -> int: ...

    def follow(self, memory: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')], period: float, is_synchronous: bool = False, share: float = 1.0) -> None:
        """
        Plan the motion of a step that lasts `period` [s], or until the target is reached, with a share of the acceleration.
        """

    def brake(self, memory: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')]) -> None:
        """Brake to rest, all joints together on a straight line where they can."""

    def advance(self, memory: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')], time: float) -> None:
        """Let time pass [s]."""

    def state(self, memory: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')], ahead: float = 0.0) -> NDArray[numpy.float64]:
        """
        Position, velocity and acceleration after so many seconds of the present plan, (3, dof).
        """

    def remaining(self, memory: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')]) -> float:
        """
        Time until the joints stand [s]; of a stream, until the plan is used up.
        """

class Springs:
    """
    Springs and dampers with which an arm gives way when it is pushed. Without numbers, the gains of the position servos are the springs and dampers of the joints.
    """

    def __init__(self, stiffness: Sequence[float] = [], damping: Sequence[float] = [], tcp_site: int = -1, base_body: int = -1) -> None:
        """
        Six numbers each, along and about x, y, z of the base: N/m, N*s/m, then Nm/rad, Nm*s/rad.
        """

class Motion(StepCallback):
    """
    Moves position servos of some joints to a target in `mjData.userdata`, within limits of velocity, acceleration and jerk. As a callback, it is true when the joints stand at their target.
    """

    def __init__(self, joints: Sequence[int], actuators: Sequence[int], address: int, limits: MotionLimits, copies: int, springs: Springs | None = None) -> None:
        """
        Joint and actuator ids, base to tip, and the first of the numbers in the user data. With springs of the TCP, the actuators are motors.
        """

    @property
    def dof(self) -> int: ...

    @property
    def address(self) -> int: ...

    def state(self, view: StepView) -> NDArray[numpy.float64]:
        """
        Position, velocity and acceleration that the joints are led to at present, (3, dof).
        """

class ArmBody:
    """
    A serial arm in a model, and what presses on it from outside: contacts with anything but the arm and its tool, and the forces of `xfrc_applied`.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[int], tcp_site: int, frame_body: int) -> None:
        """
        Joint ids from base to tip, the TCP's site, and the body whose axes wrenches have.
        """

class Measurement:
    """Values that a world reads out of every copy after each step."""

    @property
    def size(self) -> int:
        """Number of values."""

class ArmLoads(Measurement):
    """
    The torques of an arm's drives [Nm], then force [N] and moment about the TCP [Nm] of what presses on its tool, in the axes of the frame body.
    """

    def __init__(self, arm: ArmBody) -> None: ...

class FingerContacts(Measurement):
    """
    Which fingers touch something with at least a force [N] (1 or 0 each), then whether two of them touch the same object.
    """

    def __init__(self, model: mujoco.MjModel, fingers: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)]], own: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], force: float) -> None:
        """
        One uint8 flag per geom for each finger, and for the robot's own geoms, which do not count as touched.
        """

class FreeBodyVelocity(Measurement):
    """
    Velocity [m/s] of the origin of a body with a free joint, then its angular velocity [rad/s], in the axes of a frame body that stands still.
    """

    def __init__(self, model: mujoco.MjModel, joint: int, frame_body: int) -> None:
        """The ids of the joint and of the body whose axes the values have."""

class CollisionReaction(StepCallback):
    """True when what presses on an arm is more than a limit."""

    def __init__(self, arm: ArmBody, torques: Sequence[float], wrench: Sequence[float], is_of_drives: bool, time_constant: float, duration: float, copies: int) -> None:
        """
        Limits per joint [Nm] and of force and moment [N, Nm]; the filter's time constant and how long a limit must be exceeded [s].
        """

    def cause(self, copy: int) -> tuple[int, float]:
        """
        Which limit was exceeded (joints, then the wrench's six), or -1, and by which load.
        """

class StepEnd(enum.Enum):
    """Why a control step of a simulation ended."""

    period = 0
    """Asynchronous: one control period has passed."""

    converged = 1
    """Synchronous: every convergence callback agreed."""

    interrupted = 2
    """A callback interrupted the step."""

    limit = 3
    """Synchronous: the substep limit came before convergence."""

    failed = 4
    """A state or control that is not a finite number, or an exception."""

    fault = 5
    """A robot went into its fault state, as after a collision."""

class World:
    """
    N copies of one MuJoCo scene, advanced together by one control step at a time. Another call during a call, from a callback or another thread, raises WrongOrder.
    """

    @staticmethod
    def on_data(model: mujoco.MjModel, data: mujoco.MjData, period_numerator: int, period_denominator: int, is_synchronous: bool, max_substeps: int) -> World:
        """
        One copy, on the caller's own model and data, which the world and its arrays keep alive.
        """

    @staticmethod
    def of_copies(model: mujoco.MjModel, copies: int, threads: int, period_numerator: int, period_denominator: int, is_synchronous: bool, max_substeps: int) -> World:
        """
        Many copies of a copy of the model, on `threads` threads (0: one per CPU that this process may use).
        """

    def close(self) -> None:
        """
        Drop the callbacks and end the threads; those of a batch end when its last array is dropped, too. Closing twice is harmless; calls afterwards raise WrongOrder, and arrays keep their values.
        """

    @property
    def is_open(self) -> bool: ...

    @property
    def copies(self) -> int: ...

    @property
    def threads(self) -> int: ...

    @property
    def is_batch(self) -> bool:
        """False for a world on the user's own data."""

    def add_motion(self, motion: Motion) -> Motion:
        """
        Have a motion lead its joints in every step. Where there is one with the same user data, that is returned.
        """

    def preview(self, motion: Motion, target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], copy: int, tick: float) -> NDArray[numpy.float64]:
        """
        Return what the next step to a target (dof,) [rad] would do: where the joints are led to (n, dof), from now to the end of the step and while they brake to rest from there, at most every `tick` [s] and at the same times for all motions; in a synchronous step, until they stand. With an empty target, they hold. Nothing changes.
        """

    def on_period(self, callback: StepCallback, period: float) -> None:
        """Call every `period` seconds of simulated time."""

    def converge_when(self, callback: StepCallback) -> None:
        """A synchronous step ends when all of these are true."""

    def interrupt_when(self, callback: StepCallback) -> None:
        """
        A synchronous step ends when any of these is true; an asynchronous one lasts its period and says so.
        """

    def fault_when(self, callback: StepCallback) -> None:
        """
        A step of any kind ends at once when any of these is true: a robot went into its fault state.
        """

    def measure(self, measurement: Measurement) -> int:
        """
        Have something measured after every step, and after `refresh`. Returns the index of its first value in `measurements`.
        """

    def read_pose(self, site: int, frame_body: int) -> int:
        """
        Have the pose of a site in the frame of a body read out after every call. Returns its index in `poses`.
        """

    def read_body_pose(self, body: int, frame_body: int) -> int:
        """
        Have the pose of a body in the frame of another read out. Returns its index in `poses`.
        """

    def read_force(self, first: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], second: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> int:
        """
        Have the normal force between two sets of surfaces read out: one uint8 flag per geom, then, where soft bodies count too, one per flex. Returns its index.
        """

    def read_opening(self, joints: Sequence[int], closed: float, open: float) -> int:
        """
        Have the mean position of joints read out as 0 at `closed` … 1 at `open`. Returns its index in `openings`.
        """

    def keep_initial_state(self, copy: int = 0) -> None:
        """
        Take the present state of `copy` as the one that `reset` returns to, for all copies.
        """

    @overload
    def reset(self) -> None:
        """Return all copies to the initial state."""

    @overload
    def reset(self, copies: numpy.typing.ArrayLike) -> None:
        """
        Return some copies to the initial state: their ids, in any order, each once; none if there are none.
        """

    @overload
    def refresh(self) -> None:
        """Recompute the readouts of all copies after the state was written to."""

    @overload
    def refresh(self, copies: numpy.typing.ArrayLike) -> None:
        """Recompute the readouts of some copies."""

    @overload
    def advance(self) -> None:
        """Advance all copies by one control step. The GIL is released."""

    @overload
    def advance(self, copies: numpy.typing.ArrayLike) -> None:
        """Advance some copies by one control step."""

    @property
    def state_size(self) -> int:
        """Number of values of mjSTATE_INTEGRATION."""

    def get_state(self, copy: int = 0) -> NDArray[numpy.float64]:
        """The whole integration state of one copy, (state_size,)."""

    def set_state(self, state: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], copy: int = 0) -> None:
        """Write the whole integration state of one copy."""

    def save(self, copy: int = 0) -> NDArray[numpy.float64]:
        """
        Everything that decides the future of one copy, and what was read out, (save_size,).
        """

    def load(self, saved: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], copy: int = 0) -> None:
        """
        Write back what `save` returned, into any copy of a world with the same model, callbacks and readouts.
        """

    @property
    def save_size(self) -> int:
        """Number of values of `save`."""

    @property
    def states(self) -> NDArray[numpy.float64]:
        """Live state rows (copies, state_size) of a batch."""

    def component(self, which: int) -> NDArray[numpy.float64]:
        """
        Live array of one mjtState component: (copies, n), or (n,) for a world on the user's own data.
        """

    def expand(self, field: str) -> numpy.typing.NDArray[Any]:
        """
        Give a field of MjModel values per copy; returns them, (copies, size), to write to.
        """

    def expanded(self, field: str) -> numpy.typing.NDArray[Any] | None:
        """
        The values per copy of a field of MjModel that has them, (copies, size); None for one that has not.
        """

    @property
    def is_varied(self) -> bool:
        """Whether any field of the model has values per copy."""

    @overload
    def set_constants(self) -> None:
        """
        Recompute what the models of all copies derive from masses, inertias and sizes (mj_setConst).
        """

    @overload
    def set_constants(self, copies: numpy.typing.ArrayLike) -> None:
        """Recompute it for some copies."""

    @property
    def poses(self) -> NDArray[numpy.float64]:
        """
        Pose readouts ([copies,] readouts, 7): translation [m], quaternion xyzw. Ask again after adding one.
        """

    @property
    def xyzrpy(self) -> NDArray[numpy.float64]:
        """
        The same poses as translation [m] and roll, pitch, yaw [rad] (extrinsic xyz).
        """

    @property
    def forces(self) -> NDArray[numpy.float64]:
        """
        Force readouts ([copies,] readouts) [N], of the last physics step. Ask again after adding one.
        """

    @property
    def openings(self) -> NDArray[numpy.float32]:
        """
        Opening readouts ([copies,] readouts) float32, 0 … 1. Ask again after adding one.
        """

    @property
    def measurements(self) -> NDArray[numpy.float64]:
        """
        Values of all measurements ([copies,] values). Ask again after adding one.
        """

    @property
    def ends(self) -> NDArray[numpy.uint8]:
        """StepEnd of the last step (copies,) uint8."""

    @property
    def substeps(self) -> NDArray[numpy.int32]:
        """Physics steps of the last step (copies,) int32."""

    @property
    def steps(self) -> NDArray[numpy.int64]:
        """Control steps since reset (copies,) int64."""

class SimArm(Arm):
    """The arm of one copy of a world. Time passes only in `World.advance`."""

    def __init__(self, name: str, limits: ArmLimits, world: World, copy: int, motion: Motion) -> None:
        """The motion leads the joints to their target; it is added to the world."""

class GripperMap:
    """How the opening of a gripper relates to its model."""

    def __init__(self, joint_closed: float, joint_open: float, ctrl_closed: float, ctrl_open: float) -> None: ...

class SimGripper(Gripper):
    """The gripper of one copy of a world."""

    def __init__(self, name: str, max_width: float, max_force: float, world: World, copy: int, joints: Sequence[int], actuator: int, map: GripperMap) -> None: ...

class GlProbe:
    """The result of a look at one OpenGL backend."""

    @property
    def name(self) -> str:
        """"egl" or "osmesa"."""

    @property
    def ok(self) -> bool:
        """Whether MuJoCo can draw with it."""

    @property
    def detail(self) -> str:
        """Renderer and version, or why not and what to do."""

    def __repr__(self) -> str: ...

def probe_gl() -> list[GlProbe]:
    """
    Look at every OpenGL backend by making a context and dropping it. Chooses none.
    """

class Lens:
    """
    A calibrated camera: focal lengths, principal point, distortion.

    The scene is drawn on a canvas without distortion. The picture is the canvas, or is looked up in it pixel by pixel.
    """

    def __init__(self, *, scale_x: float = 1.0, scale_y: float = 1.0, cx: float, cy: float, width: int, height: int, lookup: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 2), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Describe a lens. It keeps `lookup` and does not copy it: write to it no more.

        Args:
            scale_x: Focal length along x over that of the model's field of view at the picture's height.
            scale_y: The same along y.
            cx: Column of the principal point on the canvas [pixels]; the centre of the top left pixel is (0, 0).
            cy: Its row.
            width: Width of the canvas [pixels]; without a lookup that of the picture.
            height: The same.
            lookup: Column and row on the canvas that each pixel shows, shape (height, width, 2) of the picture, float32;
                None for the same ones.
        """

class Renderer:
    """
    Draws one scene as seen by the cameras of its model, off screen.

    Calls may come from any thread; they wait for each other and run without the GIL.
    """

    def __init__(self, model: mujoco.MjModel, *, quality: str = 'fast', max_width: int = 640, max_height: int = 480, backend: str = 'auto', geom_groups: Sequence[bool] = [True, True, True, False, False, False], is_rasterised: bool = False) -> None:
        """
        Make the OpenGL objects of a model, which is not changed.

        Args:
            model: The scene; the renderer keeps it alive.
            quality: "fast" without shadows, reflections, sky and antialiasing and with coarse round shapes, or "full".
            max_width: Largest width of a picture [pixels].
            max_height: Largest height of a picture [pixels].
            backend: "auto" (EGL, else OSMesa), "egl" or "osmesa"; one per process.
            geom_groups: Which of the six groups of geoms are drawn; 3 to 5 are collision shapes by custom.
            is_rasterised: Draw colours without OpenGL in quality "fast", where OpenGL has no graphics card and the scene has neither
                textures, soft bodies nor height fields; depth and ids are drawn with it. Colours look the same but for rounding.

        Raises:
            ValueError: An argument is not valid.
            MissingDependency: There is no OpenGL; the message has the remedy.
        """

    def update(self, data: mujoco.MjData) -> None:
        """
        Take over the poses in a data, once for all cameras.

        Args:
            data: Data of the renderer's model, after `mj_forward` or `mj_kinematics`, `mj_comPos` and `mj_camlight`.
        """

    def update_from_state(self, state: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Take over the poses that follow from a state.

        Args:
            state: A row of `mjSTATE_INTEGRATION`, shape (state_size,).
        """

    def render(self, camera_id: int, rgb: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, 3), order='C', device='cpu')], depth: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu')] | None = None, ids: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu')] | None = None, lens: Lens | None = None) -> None:
        """
        Draw what a camera sees.

        Args:
            camera_id: Index of the camera in the model.
            rgb: Filled in place, shape (height, width, 3), rows from the top.
            depth: Filled in place when given, shape (height, width) [mm], 0 where nothing is or it is beyond 65.535 m.
            ids: Filled in place when given, shape (height, width), what each pixel shows: 0 nothing, otherwise 1 + the number
                of a geom, or of a flex, a skin or a tendon, which are counted on in this order.
            lens: How the camera is calibrated; None for as in the model.

        Raises:
            ValueError: There is no such camera, or the picture does not fit.
        """

    def close(self) -> None:
        """Free everything. Closing twice is harmless."""

    @property
    def is_open(self) -> bool: ...

    @property
    def state_size(self) -> int:
        """Length of a state."""

    @property
    def description(self) -> str:
        """Backend, renderer and OpenGL version."""

class RenderPool:
    """
    Draws many states of one scene at once, on several threads.

    The pictures are those of a single `Renderer`, bit for bit. Calls run without the GIL and wait for each other.
    """

    def __init__(self, model: mujoco.MjModel, threads: int, *, quality: str = 'fast', max_width: int = 640, max_height: int = 480, backend: str = 'auto', geom_groups: Sequence[bool] = [True, True, True, False, False, False], is_rasterised: bool = False) -> None:
        """
        Make one renderer for each thread.

        Args:
            model: The scene; the pool keeps it alive.
            threads: How many threads draw, the calling one included, 1 to MOST_THREADS.
            quality: As for `Renderer`, like all that follow.
            max_width: Largest width of a picture [pixels].
            max_height: Largest height of a picture [pixels].
            backend: "auto", "egl" or "osmesa".
            geom_groups: Which of the six groups of geoms are drawn.
            is_rasterised: Whether colours are drawn without OpenGL.

        Raises:
            ValueError: An argument is not valid.
            MissingDependency: There is no OpenGL; the message has the remedy.
        """

    def render_states(self, states: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], camera_ids: Sequence[int], rgb: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None, 3), order='C', device='cpu')]], depth: Sequence[Annotated[NDArray[numpy.uint16], dict(shape=(None, None, None), order='C', device='cpu')] | None] | None = None, world: World | None = None, ids: Sequence[Annotated[NDArray[numpy.uint16], dict(shape=(None, None, None), order='C', device='cpu')] | None] | None = None, lenses: Sequence[Lens | None] = []) -> None:
        """
        Draw each state with each camera.

        Args:
            states: Rows of `mjSTATE_INTEGRATION`, shape (n, state_size).
            camera_ids: Indices of the cameras in the model.
            rgb: For each camera an array that is filled in place, shape (n, height, width, 3), rows from the top.
            depth: None, or for each camera None or an array that is filled in place, shape (n, height, width) [mm].
            world: A world of as many copies, whose fields of the model row i has those of copy i; None for those of the
                pool's model.
            ids: None, or for each camera None or an array that is filled in place, shape (n, height, width), as in
                `Renderer.render`.
            lenses: Empty, or for each camera its lens or None.

        Raises:
            ValueError: A shape or a camera is not valid, or the world is of another model.
        """

    def close(self) -> None:
        """End the threads and free everything. Closing twice is harmless."""

    @property
    def is_open(self) -> bool: ...

    @property
    def threads(self) -> int: ...

    MOST_THREADS: Final[int] = ...
    """Most threads of a pool."""

    @property
    def state_size(self) -> int:
        """Length of a state."""

    @property
    def description(self) -> str:
        """Backend, renderer and OpenGL version."""

class PixelCameras:
    """
    Cameras of all copies of a world as learners want their pictures.

    After each step of a copy, the thread that has stepped it draws its cameras into arrays (copies, channels, height, width),
    where channels are those of all frames of a stack, the newest last. In quality "fast", scenes without textures, soft bodies
    and height fields are drawn without OpenGL, in a fifth to a half of the time; the pictures look the same but for rounding.
    """

    def __init__(self, model: mujoco.MjModel, copies: int, threads: int, camera_ids: Sequence[int], *, width: int, height: int, is_grayscale: bool = False, stack: int = 1, lenses: Sequence[Lens | None] = [], quality: str = 'fast', max_width: int, max_height: int, backend: str = 'auto', geom_groups: Sequence[bool] = [True, True, True, False, False, False]) -> None:
        """
        Prepare the cameras.

        Args:
            model: The scene, which is kept alive.
            copies: Copies of the world.
            threads: Its threads: how many draw at once.
            camera_ids: Indices of the cameras in the model.
            width: Width of the pictures [pixels].
            height: The same.
            is_grayscale: One channel of luma (ITU-R BT.601) instead of red, green and blue.
            stack: Frames of an observation.
            lenses: Empty, or for each camera its lens or None.
            quality: "fast" or "full", as for `Renderer`, like all that follow.
            max_width: Largest width of a picture or of a lens's canvas [pixels].
            max_height: The same of the height.
            backend: "auto", "egl" or "osmesa".
            geom_groups: Which of the six groups of geoms are drawn.

        Raises:
            ValueError: An argument is not valid.
            MissingDependency: OpenGL is needed and there is none.
        """

    def watch(self, world: World) -> None:
        """Have the threads of a world draw after each step."""

    def turn(self, to: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None, None), order='C', device='cpu')]], before: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None, None), order='C', device='cpu')]] | None = None) -> None:
        """
        Have what is drawn from now on go to some arrays, which are kept until the next turn.

        Args:
            to: For each camera an array that is filled in place, (copies, channels, height, width).
            before: For each camera the array with the frames of the step before, of the same shape; None for none.
        """

    @property
    def drawn(self) -> Annotated[NDArray[numpy.uint8], dict(writable=False)]:
        """
        Live flags (copies,): 1 for those that were drawn in a step since the last turn.
        """

    def show(self, world: World, uses: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Fill the arrays of copies as they are now, on the world's threads.

        Args:
            world: The world.
            uses: The use of each copy, (copies,) uint8: `KEEP` what was there before, `ADVANCE` (the frames of a stack move
                up for the newest), `START` (the newest frame in every place), `REPLACE` the newest frame, or `LEAVE` as it is.
        """

    @property
    def why_opengl(self) -> str:
        """Why OpenGL draws; empty if it does not."""

    KEEP: Final[int] = ...
    """(arg: object, /) -> int"""

    ADVANCE: Final[int] = ...
    """(arg: object, /) -> int"""

    START: Final[int] = ...
    """(arg: object, /) -> int"""

    REPLACE: Final[int] = ...
    """(arg: object, /) -> int"""

    LEAVE: Final[int] = ...
    """(arg: object, /) -> int"""

def add_colour_noise(rgb: Annotated[NDArray[numpy.uint8], dict(order='C', device='cpu')], table: Annotated[NDArray[numpy.int8], dict(shape=(None,), order='C', device='cpu', writable=False)], seed: int) -> None:
    """
    Add noise to colours, in place.

    Args:
        rgb: Colours of any shape.
        table: Errors of 256 equally likely cases.
        seed: Determines which ones come.
    """

def measure_stereo(depth: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order='C', device='cpu')], rgb: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, 3), order='C', device='cpu', writable=False)], *, focal: float, middle: float, baseline: float, half_width: float, nearest: float, deviation: float, steepest: float, steep_loss: float, dark: float, normal: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], seed: int) -> None:
    """
    Replace true depth by what a stereo camera would measure, in place; 0 is no reading.

    Args:
        depth: Depth in the picture of the left eye [mm], shape (height, width).
        rgb: Its colours, shape (height, width, 3).
        focal: Focal length [pixels].
        middle: Column of the principal point [pixels].
        baseline: Distance from the left eye to the right one [m].
        half_width: Tangent of half the right eye's field of view along x; 0 for no end.
        nearest: Nearest depth that can be measured [m].
        deviation: Standard deviation of a disparity [pixels].
        steepest: Tangent of the angle between view and normal from which a surface is steep.
        steep_loss: Share of steep pixels without a reading.
        dark: Brightness below which readings get lost [of 255].
        normal: Quantiles of the standard normal distribution of equally likely cases, as many as a power of two.
        seed: Determines which cases come.

    Raises:
        ValueError: A shape does not fit.
    """

@overload
def clip_rows(values: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], lower: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], tolerance: float) -> NDArray[numpy.float64] | None:
    """
    Return a copy of `values` (..., n) cut to the bounds (n,); None if one is not finite or farther out than `tolerance`.
    """

@overload
def clip_rows(values: Annotated[NDArray[numpy.float32], dict(order='C', device='cpu', writable=False)], lower: Annotated[NDArray[numpy.float32], dict(order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.float32], dict(order='C', device='cpu', writable=False)], tolerance: float) -> NDArray[numpy.float32] | None:
    """The same in float32."""

def limit_rows(asked: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], last: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], measured: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], max_step: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], max_lead: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], lower: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.float64], dict(order='C', device='cpu', writable=False)], max_return: float, rounding: float) -> tuple[NDArray[numpy.float64], NDArray[numpy.bool_]] | None:
    """
    Cut `asked` (..., n) to at most `max_step` (n,) from `last` and `max_lead` (n,) from `measured`: all joints of a row go the same share of the way from `last`.

    A joint that was pushed out of its lead goes back towards it first, by a step at most; one that is asked for less of its lead, or for the other side of the measured joint, drops it at once. One whose last target is out of its range, `lower` to `upper` (n,), comes back by `max_return` at most. Returns the targets and a flag per row that says whether it was cut by more than `rounding`; None if no row was.
    """
