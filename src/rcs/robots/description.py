"""Descriptions of arms, grippers and hands: frozen figures, and an MJCF file that agrees with them.

Every description names one MJCF file whose elements have plain names (`joint1`, `flange`, `tcp`). A scene attaches
these files to each other with prefixes; names here are without prefixes.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rcs_data.options import INFINITE, Meta, NotNegative, Positive, Record, Share

from rcs._core import ArmLimits, MotionLimits
from rcs.errors import InvalidSetup
from rcs.robots.mount import Mount as Mount

Limit = Annotated[float, Meta(gt=0), INFINITE]
Loads = Literal["outer", "drive"]
"""Torques that an arm watches at its joints: those from outside, or all that its drives exert."""


class CollisionLimits(Record):
    """Limits of the forces on an arm. An arm that exceeds one goes into its fault state.

    A force on an arm from outside is felt through its observer. A momentum observer, as arms with known dynamics have,
    gives the outer torques through a first-order filter (De Luca and Mattone 2005, Haddadin et al. 2017).
    """

    joint_torque: tuple[Limit, ...]
    """Largest torque at each joint [Nm]; infinite for none."""
    loads: Loads = "outer"
    """The torques that are compared with them."""
    force: Limit = math.inf
    """Largest outer force along each axis of the base [N]."""
    moment: Limit = math.inf
    """Largest outer moment about the TCP along each axis of the base [Nm]."""
    time_constant: NotNegative = 0.0
    """Time constant of the observer [s]; 0 for none."""
    duration: NotNegative = 0.0
    """How long a limit must be exceeded [s]."""


class MenagerieBody(Record):
    """The source of one body's detailed visuals."""

    body: str
    """Body of the built-in model whose visual geoms are replaced."""
    source: str
    """Body of the collection's model that carries the meshes."""
    source_in_body: Mount = Mount()
    """Pose of the source's body frame in the frame of the built-in body."""


class MenagerieVisuals(Record):
    """The model of `mujoco-menagerie` with detailed meshes of a robot."""

    model: str
    """Name of the model in the collection, such as `franka_fr3`."""
    entry: str
    """Entry point of the model: its XML file without ending."""
    bodies: tuple[MenagerieBody, ...]
    """Where the meshes go. A body may occur more than once; others keep their primitives."""

    @staticmethod
    def of(model: str, entry: str, bodies: Mapping[str, str]) -> MenagerieVisuals:
        """Return visuals whose body frames agree; `bodies` maps built-in bodies to their sources."""
        return MenagerieVisuals(
            model=model,
            entry=entry,
            bodies=tuple(MenagerieBody(body=body, source=source) for body, source in bodies.items()),
        )


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
        """Limits that bound the trajectories of the arm."""
        rates = self.velocity_limit, self.acceleration_limit, self.jerk_limit
        return MotionLimits(list(self.joint_lower), list(self.joint_upper), *map(list, rates))

    @property
    def arm_limits(self) -> ArmLimits:
        """Limits of a device that is this arm."""
        return ArmLimits(
            list(self.joint_lower),
            list(self.joint_upper),
            list(self.velocity_limit),
            joint_acceleration=list(self.acceleration_limit),
            joint_jerk=list(self.jerk_limit),
            joint_effort=list(self.effort_limit),
        )

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

    @property
    def actuators(self) -> tuple[str, ...]:
        """All actuators: the one."""
        return (self.actuator,)

    def joints_of(self, opening: ArrayLike) -> NDArray[np.float64]:
        """Return the positions of the finger joints [m or rad], (..., n), at an opening, 0 … 1, (..., 1)."""
        closed, opened = np.array(self.joint_closed), np.array(self.joint_open)
        return closed + np.asarray(opening) * (opened - closed)


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

    def joints_of(self, normalised: ArrayLike) -> NDArray[np.float64]:
        """Return joint positions [rad] of normalised ones, 0 … 1, (..., n)."""
        lower, upper = np.array(self.joint_lower), np.array(self.joint_upper)
        return lower + np.asarray(normalised) * (upper - lower)

    @property
    def joint_open(self) -> tuple[float, ...]:
        """Joint positions before a grasp [rad]."""
        return tuple(self.joints_of(self.open_pose).tolist())

    @property
    def ctrl_open(self) -> tuple[float, ...]:
        """Control values before a grasp: the joint positions."""
        return self.joint_open
