"""Every key of an action or an observation, with its shape, unit and bounds, and the check of actions against them.

| key | shape | unit |
|---|---|---|
| `joints` | (dof,) float64 | rad |
| `tquat` | (7,) float64 | TCP translation m, quaternion xyzw |
| `xyzrpy` | (6,) float64 | TCP translation m, roll-pitch-yaw rad (extrinsic xyz) |
| `xyzyaw` | (4,) float64 | change of the TCP's translation m and of its yaw rad, with the layer `KeepTilt` |
| `twist` | (6,) float64 | velocity of the TCP, in the base frame: linear m/s, angular rad/s |
| `joint_velocities` | (dof,) float64 | rad/s |
| `gripper` | (1,) float32 | 0 closed … 1 open |
| `hand` | (n,) float32 | normalised joints 0 … 1 |
| `raw` | (n,) float64 | an action of another project's simulator, in its own numbers |
| `joint_torques` | (dof,) float64 | Nm, what the drives exert, with what holds the arm against its weight |
| `tcp_wrench` | (6,) float64 | N, Nm: what presses on the tool, about the TCP, in the axes of the base |
| `finger_contacts` | (fingers,) uint8 | 1 for a finger that touches something |
| `is_grasped` | (1,) uint8 | 1 if two fingers touch the same object |
| `target`/`tquat` | (7,) float64 | the last target of the TCP, with the layer `ObserveTarget`: m, xyzw |
| `target`/`joints` | (dof,) float64 | the last target of control by joints, with the same layer: rad |
| `privileged`/object/`tquat` | (7,) float64 | pose in the base frame (of several robots: the scene), m, xyzw |
| `privileged`/object/`velocity` | (6,) float64 | m/s, rad/s, in the axes of the same frame |
| `frames`/camera/`rgb` | (H, W, 3) uint8 | |
| `frames`/camera/`depth` | (H, W) uint16 | mm, 0 = no reading |
| `frames`/camera/`segmentation` | (H, W) uint16 | number of the instance, 0 = background |
| `frames`/camera/`geoms` | (H, W) uint16 | number of the geom, 0 = background |
| `frames`/camera/`points` | (H, W, 3) float32 | m in the frame of `extrinsics`, (0, 0, 0) = no reading |
| `frames`/camera/`pixels` | (channels, H, W) uint8 | with `pixels` in the setup, alone: newest frame last |
| `frames`/camera/`intrinsics` | (3, 3) float64 | camera matrix, px |
| `frames`/camera/`distortion` | (5,) float64 | OpenCV's k1, k2, p1, p2, k3 |
| `frames`/camera/`extrinsics` | (4, 4) float64 | camera in the base frame (of several robots: the scene), OpenCV |
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs._core import clip_rows
from rcs.errors import InvalidAction
from rcs.spatial.pinhole import COEFFICIENTS

Control = Literal["joints", "tquat", "xyzrpy", "twist"]
"""Kind of an arm's action."""

Observed = Literal["torques", "wrench", "contacts", "privileged"]
"""Optional parts of an observation, beside positions and frames."""

Arrays = Mapping[str, NDArray[Any]]
"""An action or the robot's part of an observation: one array per key, of any leading shape."""

Action = dict[str, Any]
"""An array per key, or, with several robots, such a dictionary per robot."""

Observation = dict[str, Any]
"""Arrays per key, and under `frames` a dictionary per camera."""

JOINTS = "joints"
TQUAT = "tquat"
XYZRPY = "xyzrpy"
XYZYAW = "xyzyaw"
TWIST = "twist"
JOINT_VELOCITIES = "joint_velocities"
GRIPPER = "gripper"
HAND = "hand"
RAW = "raw"
FRAMES = "frames"
RGB = "rgb"
DEPTH = "depth"
SEGMENTATION = "segmentation"
GEOMS = "geoms"
POINTS = "points"
PIXELS = "pixels"
DISTORTION = "distortion"
INTRINSICS = "intrinsics"
EXTRINSICS = "extrinsics"
JOINT_TORQUES = "joint_torques"
TCP_WRENCH = "tcp_wrench"
FINGER_CONTACTS = "finger_contacts"
IS_GRASPED = "is_grasped"
PRIVILEGED = "privileged"
TARGET = "target"
ORIGIN = "origin"
VELOCITY = "velocity"

ARM_KEYS = (JOINTS, TQUAT, TWIST)
"""Keys of an arm's targets: joints, or a pose or twist to which its controller leads the TCP."""

LOADS: Mapping[Observed, str] = {"torques": JOINT_TORQUES, "wrench": TCP_WRENCH}
"""Keys of what measures forces on an arm."""

UNITS = {
    JOINTS: "rad",
    TQUAT: "m, xyzw",
    XYZRPY: "m, rad",
    XYZYAW: "m, rad",
    TWIST: "m/s, rad/s",
    JOINT_VELOCITIES: "rad/s",
    JOINT_TORQUES: "Nm",
    TCP_WRENCH: "N, Nm",
    VELOCITY: "m/s, rad/s",
    DEPTH: "mm",
    INTRINSICS: "px",
}
"""Unit of a key, where it has one."""

REACH = 2.0
"""Bound on the coordinates of a pose [m], beyond the reach of any arm here."""

FASTEST = 100.0
"""Bound on measured joint velocities [rad/s]: collisions exceed a servo's limits, but not by this much."""

STRONGEST = 1e5
"""Bound on measured forces and moments [N, Nm], far beyond any collision."""

MINIMAL_NORM = 0.1
"""Shorter quaternions are rejected as degenerate."""

LONGEST_FOCAL_LENGTH = 1e5
"""Bound on the entries of a camera matrix [px]."""

FARTHEST = 100.0
"""Bound on the coordinates of a camera [m]."""

FARTHEST_POINT = 1000.0
"""Bound on the coordinates of a point that a camera sees [m]; depth ends at 65.535 m."""

STRONGEST_DISTORTION = 1e6
"""Bound on the coefficients of a lens's distortion."""

TOLERANCE = 1e-6
"""Tolerance of bounds for rounding: a bound converted to float32 is off by up to 1e-7."""


def joints_space(lower: ArrayLike, upper: ArrayLike) -> spaces.Box:
    """Return the space of joint positions [rad]."""
    return spaces.Box(np.array(lower, np.float64), np.array(upper, np.float64), dtype=np.float64)


def tquat_space() -> spaces.Box:
    """Return the space of poses as translation [m] and quaternion xyzw."""
    bound = np.array([REACH] * 3 + [1.0] * 4)
    return spaces.Box(-bound, bound, dtype=np.float64)


def xyzrpy_space() -> spaces.Box:
    """Return the space of poses as translation [m] and roll, pitch, yaw [rad]."""
    bound = np.array([REACH] * 3 + [np.pi] * 3)
    return spaces.Box(-bound, bound, dtype=np.float64)


def measured(space: spaces.Box, margin: float) -> spaces.Box:
    """Return a space of measurements for a space of commands, which a servo overshoots by up to `margin`."""
    return spaces.Box(space.low - margin, space.high + margin, dtype=np.float64)


def velocities_space(dof: int) -> spaces.Box:
    """Return the space of measured joint velocities [rad/s], which only a diverged simulation exceeds."""
    return spaces.Box(-FASTEST, FASTEST, (dof,), np.float64)


def load_spaces(effort_limit: ArrayLike) -> dict[str, spaces.Box]:
    """Return the spaces of joint torques [Nm], up to twice the effort limits, and of the wrench at the TCP [N, Nm]."""
    most = 2.0 * np.array(effort_limit, np.float64)
    return {
        JOINT_TORQUES: spaces.Box(-most, most, dtype=np.float64),
        TCP_WRENCH: spaces.Box(-STRONGEST, STRONGEST, (6,), np.float64),
    }


def flags_space(size: int) -> spaces.Box:
    """Return the space of flags, 0 or 1."""
    return spaces.Box(0, 1, (size,), np.uint8)


def object_space() -> spaces.Dict:
    """Return the space of an object: its pose as translation [m] and quaternion xyzw, and its velocity [m/s, rad/s].

    An object that slips out of a gripper may spin fast.
    """
    bound = np.array([FARTHEST] * 3 + [1.0] * 4)
    velocity = spaces.Box(-10.0 * FASTEST, 10.0 * FASTEST, (6,), np.float64)
    return spaces.Dict({TQUAT: spaces.Box(-bound, bound, dtype=np.float64), VELOCITY: velocity})


def normalised_space(size: int) -> spaces.Box:
    """Return the space of openings or hand joints, 0 … 1."""
    return spaces.Box(0.0, 1.0, (size,), np.float32)


def require_direction(tquat: NDArray[np.float64]) -> None:
    """Check that the quaternions of poses (..., 7) can be normalised.

    Raises:
        InvalidAction: One has nearly no length.
    """
    norms = np.sqrt((tquat[..., 3:] ** 2).sum(axis=-1))
    if (norms < MINIMAL_NORM).any():
        raise InvalidAction(
            f"The quaternion of {TQUAT!r} has norm {norms.min():.3g}; valid is a unit quaternion xyzw, "
            "and (0, 0, 0, 1) for no rotation. Nothing was sent to the device."
        )


def frame_space(entries: Iterable[str], size: tuple[int, int], *, channels: int = 3) -> spaces.Dict:
    """Return the space of a camera's frame.

    Args:
        entries: Its keys, such as `rgb` and `extrinsics`.
        size: Width and height [px].
        channels: Number of channels of `pixels`.
    """
    width, height = size
    image, matrix = (height, width), np.float64
    boxes: dict[str, tuple[float, float, tuple[int, ...], type[np.integer[Any] | np.floating[Any]]]] = {
        RGB: (0, 255, (*image, 3), np.uint8),
        DEPTH: (0, 65535, image, np.uint16),
        SEGMENTATION: (0, 65535, image, np.uint16),
        GEOMS: (0, 65535, image, np.uint16),
        POINTS: (-FARTHEST_POINT, FARTHEST_POINT, (*image, 3), np.float32),
        PIXELS: (0, 255, (channels, *image), np.uint8),
        INTRINSICS: (0.0, LONGEST_FOCAL_LENGTH, (3, 3), matrix),
        DISTORTION: (-STRONGEST_DISTORTION, STRONGEST_DISTORTION, (COEFFICIENTS,), matrix),
        EXTRINSICS: (-FARTHEST, FARTHEST, (4, 4), matrix),
    }
    return spaces.Dict({key: spaces.Box(*boxes[key][:3], dtype=boxes[key][3]) for key in entries})


class ActionCheck:
    """Checks actions against the spaces of their keys; made once, called at every step."""

    def __init__(self, boxes: Mapping[str, spaces.Box], leading: tuple[int, ...] = ()) -> None:
        """Prepare the check.

        Args:
            boxes: The valid space of every key.
            leading: Leading shape that every array must have: () or (copies,).
        """
        self._boxes = dict(boxes)
        self._forms: list[tuple[str, spaces.Box, tuple[int, ...], Any, NDArray[Any], NDArray[Any]]] = [
            (key, box, leading + box.shape, box.dtype, box.low, box.high) for key, box in boxes.items()
        ]

    def __call__(self, action: Any, *places: Arrays) -> dict[str, NDArray[Any]]:
        """Check an action and return it as fresh arrays of the right dtype.

        Args:
            action: A mapping with one array per key.
            places: Values by key that an action may go as far out of the bounds as.

        Returns:
            One array per key, (*leading, *shape), inside the bounds.

        Raises:
            InvalidAction: A key is missing or unknown, or an array has a wrong shape or dtype, is not finite or is out
                of bounds; the message names the key, the given and the valid values.
        """
        if not isinstance(action, Mapping) or action.keys() != self._boxes.keys():
            raise InvalidAction(_describe_keys(action, self._boxes))
        checked: dict[str, NDArray[Any]] = {}
        for key, box, shape, dtype, low, high in self._forms:
            array = action[key]
            if type(array) is not np.ndarray or array.dtype != dtype or not array.flags.c_contiguous:
                array = _as_numbers(key, array, box)
            if array.shape != shape:
                raise InvalidAction(f"Action {key!r} has shape {array.shape}; valid is {shape}.")
            for place in places:
                if key in place:
                    low, high = np.minimum(low, place[key]), np.maximum(high, place[key])
            clipped = clip_rows(array, low, high, TOLERANCE)
            if clipped is None:
                raise InvalidAction(_describe_value(key, array, box))
            checked[key] = clipped
        return checked


def _as_numbers(key: str, given: Any, box: spaces.Box) -> NDArray[Any]:
    if np.ma.is_masked(given):
        raise InvalidAction(f"Action {key!r} has masked values; valid is an array without a mask.")
    try:
        array = np.asarray(given)
    except ValueError as err:
        raise InvalidAction(f"Action {key!r} is not an array: {err}") from err
    if array.dtype.kind not in "fiu":
        raise InvalidAction(f"Action {key!r} has dtype {array.dtype}; valid is {box.dtype} or another number type.")
    shape = (1,) if array.shape == () and box.shape == (1,) else array.shape  # a plain number for a gripper
    return np.ascontiguousarray(array, box.dtype).reshape(shape)


def _describe_keys(action: Any, boxes: Mapping[str, spaces.Box]) -> str:
    valid = ", ".join(f"{key!r} {box.shape} {box.dtype}" for key, box in boxes.items())
    if not isinstance(action, Mapping):
        hint = " rcs.rl.FlatEnv(env) takes one vector." if isinstance(action, np.ndarray) else ""
        return f"Expected a mapping with the keys {valid} as action; got {type(action).__name__}.{hint}"
    missing = [key for key in boxes if key not in action]
    unknown = [key for key in action if key not in boxes]
    found = [f"{text} {keys}" for text, keys in (("missing", missing), ("unknown", unknown)) if keys]
    return f"The action's keys are wrong ({'; '.join(found)}). Valid: {valid}."


def _describe_value(key: str, array: NDArray[Any], box: spaces.Box) -> str:
    bad = ~((array >= box.low - TOLERANCE) & (array <= box.high + TOLERANCE))
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    inner = index[len(index) - len(box.shape) :]
    where = ", ".join(str(i) for i in index)
    return (
        f"Action {key!r}[{where}] is {array[index]}; valid is {box.low[inner]:.6g} to {box.high[inner]:.6g}. "
        "Nothing was sent to the device."
    )


def split_by_robot(names: Iterable[str], value: Any) -> dict[str, Any]:
    """Return the parts of an observation, an action or a space of an environment, by the names of its robots."""
    known = list(names)
    return {known[0]: value} if len(known) == 1 else {name: value[name] for name in known}


def join_robots(parts: Mapping[str, Any]) -> Any:
    """Return the parts by robot in the form of an environment; the inverse of `split_by_robot`."""
    return next(iter(parts.values())) if len(parts) == 1 else dict(parts)


def robot_prefixes(names: Iterable[str]) -> dict[str, str]:
    """Return the prefix of the keys of each robot in a dataset: empty for a single robot."""
    known = list(names)
    return {known[0]: ""} if len(known) == 1 else {name: f"{name}/" for name in known}
