"""Descriptions of arms, grippers, hands and cameras: frozen figures, and an MJCF file that agrees with them.

Every description names one MJCF file whose elements have plain names (`joint1`, `flange`, `tcp`). A scene attaches
these files to each other with prefixes; names here are without prefixes.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from rcs_data.record import Meta, NotNegative, Positive, Record, Share

from rcs._core import ArmLimits, MotionLimits
from rcs.errors import InvalidSetup
from rcs.robots.camera_mode import ResolutionMode, choose_rate, find_mode
from rcs.robots.collision_limits import CollisionLimits
from rcs.robots.menagerie import MenagerieBody, MenagerieVisuals
from rcs.robots.mount import Mount

__all__ = [
    "ArmDescription",
    "CameraDescription",
    "CollisionLimits",
    "Description",
    "GripperDescription",
    "HandDescription",
    "MenagerieBody",
    "MenagerieVisuals",
    "Mount",
    "ResolutionMode",
]


class Description(Record):
    """The fields of all descriptions: names, model file and sources."""

    name: str
    """Short name, such as `fr3`."""
    label: str
    """Full name for people."""
    module: str = ""
    """Name of the module that defines the description; the model's file lies next to it."""
    mjcf_file: str
    """File name of the MJCF model, or its whole path; an arm may have a URDF, together with `complete`."""
    base_body: str
    """Body whose frame is the base frame; it is fixed to the world or a mount, and has no pose in the file."""
    sources: tuple[str, ...]
    """Sources of the figures."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidSetup: A field has an invalid value.
        """
        try:
            super().__post_init__()
        except InvalidSetup as err:
            raise InvalidSetup(f"{self.name}: {err}") from err

    def _require_length(self, count: int, *tables: str) -> None:
        for table in tables:
            if len(getattr(self, table)) != count:
                raise InvalidSetup(f"{self.name}.{table} is {getattr(self, table)}; valid are {count} finite numbers.")

    @property
    def mjcf(self) -> Path:
        """Path of the MJCF model or URDF.

        Raises:
            InvalidSetup: The module is not a file on disk.
        """
        if Path(self.mjcf_file).is_absolute():
            return Path(self.mjcf_file)
        if not self.module:
            raise InvalidSetup(
                f"{self.name}: mjcf_file is {self.mjcf_file!r}; without a module it is an absolute path."
            )
        origin = importlib.import_module(self.module).__file__
        if origin is None:
            raise InvalidSetup(f"{self.module} is not a file on disk, so {self.mjcf_file} cannot be next to it.")
        return Path(origin).parent / self.mjcf_file


class ArmDescription(Description):
    """One manipulator: its chain, its limits and the MJCF file with the same figures."""

    joints: tuple[str, ...]
    """Joints from base to tip."""
    actuators: tuple[str, ...]
    """Position actuators in the order of `joints`; their control is a joint position [rad]."""
    flange_site: str
    """Site where a gripper or a tool is attached."""
    home: tuple[float, ...]
    """Joint positions of the rest pose [rad]."""
    joint_lower: tuple[float, ...]
    """Lower joint limits [rad]."""
    joint_upper: tuple[float, ...]
    """Upper joint limits [rad]."""
    velocity_limit: tuple[Positive, ...]
    """Largest joint speeds [rad/s]."""
    acceleration_limit: tuple[Positive, ...]
    """Largest joint accelerations [rad/s^2]."""
    jerk_limit: tuple[Positive, ...]
    """Largest joint jerks [rad/s^3]."""
    effort_limit: tuple[Positive, ...]
    """Largest joint torques [Nm]."""
    workspace_reach: Positive
    """Reach of the flange from the shoulder [m]."""
    payload: Positive | None = None
    """Rated load at the flange, the end effector included [kg]; None if none is published."""
    tcp_speed: Positive = 0.5
    """Largest translation of the TCP along each axis in relative control [m/s]. Our choice: in nine of ten postures
    within 0.6 rad of home, `velocity_limit` allows all built-in arms with six or seven joints 0.6 m/s along every axis.
    """
    tcp_turn_speed: Positive = 1.8
    """Largest rotation of the TCP in relative control [rad/s]: `velocity_limit` allows it to the slowest of them there.
    """
    collision: CollisionLimits | None = None
    """When it takes what it feels for a collision; None for an arm that does not react."""
    end_effectors: tuple[str, ...] | None = None
    """Names of the end effectors that fit its flange; None for any."""
    menagerie: MenagerieVisuals | None = None
    """Source of detailed visuals; None if the collection has none."""
    complete: Callable[[Any], None] | None = None
    """Completes the model with what its file cannot describe, such as actuators of a URDF; called with its
    `mujoco.MjSpec` at each reading."""

    def __post_init__(self) -> None:
        """Check that all tables have one entry per joint and that the home pose lies inside the limits.

        Raises:
            InvalidSetup: A table has the wrong length, a limit is not positive, or the home pose is outside the limits.
        """
        super().__post_init__()
        dof = len(self.joints)
        if dof == 0 or len(set(self.joints)) != dof:
            raise InvalidSetup(f"{self.name}: joints must be at least one and have different names, got {self.joints}.")
        if len(self.actuators) != dof:
            raise InvalidSetup(f"{self.name}: {dof} joints need {dof} actuators, got {self.actuators}.")
        self._require_length(dof, "home", "joint_lower", "joint_upper")
        self._require_length(dof, "velocity_limit", "acceleration_limit", "jerk_limit", "effort_limit")
        if self.collision is not None and len(self.collision.joint_torque) != dof:
            raise InvalidSetup(
                f"{self.name}.collision has {len(self.collision.joint_torque)} joint torques for {dof} joints."
            )
        for joint, lower, q, upper in zip(self.joints, self.joint_lower, self.home, self.joint_upper, strict=True):
            if not lower <= q <= upper:
                raise InvalidSetup(
                    f"{self.name}: home of {joint} is {q} rad, outside of its limits {lower} .. {upper}."
                )

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def motion_limits(self) -> MotionLimits:
        """What bounds the trajectories of the arm."""
        rates = self.velocity_limit, self.acceleration_limit, self.jerk_limit
        return MotionLimits(list(self.joint_lower), list(self.joint_upper), *map(list, rates))

    def within(self, limits: ArmLimits, device: str) -> ArmDescription:
        """Return the arm with the narrower ones of its limits and those of a device; what is unknown there stays.

        A home pose outside the device's range moves to the edge of it.

        Args:
            limits: Limits of the device.
            device: Name of the device, for messages.

        Raises:
            InvalidSetup: The device has another number of joints, or a joint's range has nothing of that here.
        """
        if len(limits.joint_lower) != self.dof:
            raise InvalidSetup(f"{device} has {len(limits.joint_lower)} joints; {self.label} has {self.dof}.")
        lower = np.maximum(self.joint_lower, limits.joint_lower)
        upper = np.minimum(self.joint_upper, limits.joint_upper)
        for i in np.flatnonzero(lower >= upper):
            raise InvalidSetup(
                f"{device} moves {self.joints[i]} from {limits.joint_lower[i]:g} to {limits.joint_upper[i]:g} rad; "
                f"{self.label} from {self.joint_lower[i]:g} to {self.joint_upper[i]:g} rad. Give the driver the "
                "offsets of its joints, or choose the robot that it is."
            )
        return replace(
            self,
            home=tuple(np.clip(self.home, lower, upper).tolist()),
            joint_lower=tuple(lower.tolist()),
            joint_upper=tuple(upper.tolist()),
            velocity_limit=_narrower(self.velocity_limit, limits.joint_velocity),
            acceleration_limit=_narrower(self.acceleration_limit, limits.joint_acceleration),
            jerk_limit=_narrower(self.jerk_limit, limits.joint_jerk),
            effort_limit=_narrower(self.effort_limit, limits.joint_effort),
        )


def _narrower(own: tuple[float, ...], limits: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(np.minimum(own, limits).tolist()) if limits.size else own


class GripperDescription(Description):
    """One gripper with a single opening width."""

    mount_in_flange: Mount
    """Pose of the base body in the flange frame."""
    tcp_site: str
    """Site of the tool centre point, between the finger pads."""
    tcp_in_base: Mount
    """Pose of the TCP in the frame of the base body."""
    joints: tuple[str, ...]
    """Finger joints."""
    joint_closed: tuple[float, ...]
    """Positions of `joints` when closed [m or rad]."""
    joint_open: tuple[float, ...]
    """Positions of `joints` when open [m or rad]."""
    actuator: str
    """The one actuator that drives all fingers."""
    ctrl_closed: float
    """Control value of the actuator that closes."""
    ctrl_open: float
    """Control value of the actuator that opens."""
    pad_geoms: tuple[tuple[str, ...], tuple[str, ...]]
    """Geoms that touch a grasped object: of the left finger, and of the right finger.

    Left is towards the TCP's y axis, and z points along the fingers; tactile sensors rely on that.
    """
    max_width: Positive
    """Distance between the pads when open [m]."""
    max_force: Positive
    """Largest continuous force per finger [N]."""
    grasp_force: Positive
    """Force limit per finger of the MJCF model's actuator [N]; at most `max_force`."""
    closing_speed: Positive
    """Speed of each finger in free motion [m/s]."""
    arms: tuple[str, ...] | None = None
    """Names of the arms that it fits; None for any."""
    menagerie: MenagerieVisuals | None = None
    """Source of detailed visuals; None if the collection has none."""

    def __post_init__(self) -> None:
        """Check lengths and signs.

        Raises:
            InvalidSetup: A table has the wrong length, a pad is missing, end positions are equal, or a figure is out of
                range.
        """
        super().__post_init__()
        self._require_length(len(self.joints), "joint_closed", "joint_open")
        if not self.joints or self.ctrl_closed == self.ctrl_open:
            raise InvalidSetup(f"{self.name}: needs a finger joint and different ctrl_closed and ctrl_open.")
        if not all(self.pad_geoms):
            raise InvalidSetup(f"{self.name}: pad_geoms needs a geom for each finger, got {self.pad_geoms}.")
        if self.grasp_force > self.max_force:
            raise InvalidSetup(f"{self.name}: grasp_force {self.grasp_force} N is above max_force {self.max_force} N.")


class HandDescription(Description):
    """One hand with individually driven joints; targets are normalised to the joints' ranges."""

    mount_in_flange: Mount
    """Pose of the base body in the flange frame."""
    tcp_site: str
    """Site of the tool centre point, where the centre of a grasped object belongs."""
    tcp_in_base: Mount
    """Pose of the TCP in the frame of the base body."""
    joints: tuple[str, ...]
    """Finger joints in the order of the device's driver."""
    actuators: tuple[str, ...]
    """Position actuators in the order of `joints`; their control is a joint position [rad]."""
    joint_lower: tuple[float, ...]
    """Joint positions at the normalised value 0 [rad]."""
    joint_upper: tuple[float, ...]
    """Joint positions at the normalised value 1 [rad]."""
    open_pose: tuple[Share, ...]
    """Normalised joints of the hand before a grasp."""
    grasps: Mapping[str, tuple[Share, ...]]
    """Normalised targets of closed hands by name; a grasped object stops the fingers before they arrive."""
    finger_geoms: Mapping[str, tuple[str, ...]]
    """Geoms that touch a grasped object, by finger."""

    def __post_init__(self) -> None:
        """Check lengths, ascending limits and normalised targets.

        Raises:
            InvalidSetup: A table has the wrong length, a range does not ascend, or a target is outside of 0 .. 1.
        """
        super().__post_init__()
        dof = len(self.joints)
        if dof == 0 or len(self.actuators) != dof:
            raise InvalidSetup(f"{self.name}: needs a joint, and an actuator for each, got {self.actuators}.")
        self._require_length(dof, "joint_lower", "joint_upper", "open_pose")
        if any(lower >= upper for lower, upper in zip(self.joint_lower, self.joint_upper, strict=True)):
            raise InvalidSetup(f"{self.name}: every joint_lower must be below its joint_upper.")
        for grasp, targets in self.grasps.items():
            if len(targets) != dof:
                raise InvalidSetup(f"{self.name}: grasp {grasp!r} has {len(targets)} numbers; valid are {dof}.")


class CameraDescription(Description):
    """One colour camera, with or without depth; setups decide where it is mounted.

    The frame of the base body is the optical frame of the colour sensor: x right, y down, z forward (OpenCV axes). A
    calibrated pose is therefore the pose of the body.
    """

    camera: str
    """Name of the camera element."""
    mount_hole_in_optical: Mount
    """Pose of the tripod hole in the optical frame; its x axis points along the view, its z axis into the housing."""
    modes: tuple[ResolutionMode, ...]
    """Colour formats with their frame rates."""
    fovy: Annotated[float, Meta(gt=0, lt=math.pi)]
    """Vertical field of view of the colour image [rad], at the native aspect ratio."""
    native_aspect: Positive
    """Width over height of the sensor's own format."""
    has_depth: bool
    """Whether the camera measures depth."""
    depth_range: tuple[float, float]
    """Nearest and farthest depth with useful accuracy [m]; (0, 0) without depth."""
    min_depth: tuple[tuple[int, int, float], ...]
    """Nearest depth by depth format: width [px], height [px], depth [m]."""
    stereo_baseline: float = 0.05
    """Distance between the two eyes of a depth camera [m]; depth noise grows as depth squared over it."""
    stereo_fovx: float = 0.0
    """Horizontal field of view of the eyes [rad]; what the right one does not see has no depth. 0 if it is unknown."""
    longest_exposure: NotNegative = 0.0
    """Longest exposure for which the camera slows down [s]; if it exceeds the frame period, intervals vary between the
    two. 0 for a camera that keeps its rate."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            InvalidSetup: There is no mode or a name is used twice, the field of view is outside of 0 .. pi, an exposure
                is negative, or the depth range does not ascend.
        """
        super().__post_init__()
        if not self.modes or len({mode.name for mode in self.modes}) != len(self.modes):
            raise InvalidSetup(f"{self.name}: modes needs at least one, all of different sizes, got {self.modes}.")
        near, far = self.depth_range
        if self.has_depth and not 0.0 < near < far:
            raise InvalidSetup(f"{self.name}: depth_range {self.depth_range} m must ascend from above 0.")

    def mode(self, name: str) -> ResolutionMode:
        """Return the mode with a name such as `848x480`.

        Raises:
            UnknownName: There is no such mode; the message lists all.
        """
        return find_mode(self.name, self.modes, name)

    def frame_rate(self, size: tuple[int, int], wanted: float | None = None) -> int:
        """Return the frame rate for a size [frames/s].

        Args:
            size: Width and height [px]; cropped from a larger mode if it is not one.
            wanted: The wanted rate [frames/s]; None for the highest.

        Raises:
            InvalidSetup: The camera does not offer it; the message lists all modes.
        """
        return choose_rate(self.name, self.modes, size, wanted)

    def intrinsics(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the camera matrix of an ideal image of this camera, without distortion.

        Pixels are square and the principal point is the image's centre. Every format shows the sensor's full height;
        narrower ones lose the sides. This matches MuJoCo for the same `fovy`, and the camera's own 16:9 and 4:3 colour
        formats.

        Args:
            width: Width of the image [px].
            height: Height of the image [px].

        Returns:
            Camera matrix [px], shape (3, 3); the centre of the top left pixel is (0, 0), as in OpenCV.

        Raises:
            InvalidSetup: A size is not positive, or the image is wider than the sensor.
        """
        if width <= 0 or height <= 0:
            raise InvalidSetup(f"{self.name}: image size is {width} x {height} px; both must be positive.")
        # One pixel of slack: 854 x 480 and other rounded 16:9 formats are not wider than the sensor.
        if width > self.native_aspect * height + 1.0:
            widest = int(self.native_aspect * height)
            raise InvalidSetup(
                f"{self.name}: {width} x {height} px is wider than the sensor; {height} px of height allow {widest} px."
            )
        focal = 0.5 * height / math.tan(0.5 * self.fovy)
        return np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
