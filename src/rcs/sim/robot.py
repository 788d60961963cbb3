"""A simulated robot, in every copy of a world at once: targets in, measurements out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import GripperMap, JointsAtRest, Motion, SimArm, SimGripper, Trajectory
from rcs.errors import InvalidSetup
from rcs.robots.description import GripperDescription, HandDescription
from rcs.sim.robot_model import LOAD, LOAD_MASS, springs_of
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import Copies, World

STILL_TOLERANCE = 1e-2
"""Fingers that are slower than this are at rest [rad/s, m/s]."""
REST_TIME = 0.05
"""Time without motion after which fingers are at rest [s]; less would include a gripper that is about to start."""
Index = slice | NDArray[np.intp]
"""Selects elements of the last axis; a slice if they are neighbours, which costs a third."""


@dataclass(frozen=True, kw_only=True)
class RobotLayout:
    """Indices of one robot in a model."""

    joint_ids: list[int]
    actuator_ids: list[int]
    qpos: Index
    qvel: Index
    motion: int
    """First number of the arm's motion in the user data."""
    base_body: int
    tcp_site: int
    finger_joint_ids: list[int]
    """Joints of the gripper or hand; none without one, as for the rest."""
    finger_actuator_ids: list[int]
    finger_qpos: Index
    finger_qvel: Index
    finger_ctrl: Index

    @staticmethod
    def of(robot: RobotPlacement, model: mujoco.MjModel) -> RobotLayout:
        """Look a robot up in a model.

        Raises:
            InvalidSetup: The robot is not in the model.
        """
        effector, prefix = robot.end_effector, robot.gripper_prefix
        drives = () if effector is None else effector.actuators

        def ids(find: Any, prefix: str, names: Iterable[str]) -> list[int]:
            return [find(prefix + name).id for name in names]

        try:
            joints = ids(model.joint, robot.prefix, robot.arm.joints)
            actuators = ids(model.actuator, robot.prefix, robot.arm.actuators)
            fingers = ids(model.joint, prefix, () if effector is None else effector.joints)
            finger_actuators = ids(model.actuator, prefix, drives)
            base = model.body(robot.base_body).id
            tcp = model.site(robot.tcp_site).id
            motion = int(model.numeric(robot.motion).data[0])
        except KeyError as err:
            raise InvalidSetup(f"Robot {robot.name!r} is not in this model: {err}") from err
        return RobotLayout(
            joint_ids=joints,
            actuator_ids=actuators,
            qpos=_index(model.jnt_qposadr[joints]),
            qvel=_index(model.jnt_dofadr[joints]),
            motion=motion,
            base_body=base,
            tcp_site=tcp,
            finger_joint_ids=fingers,
            finger_actuator_ids=finger_actuators,
            finger_qpos=_index(model.jnt_qposadr[fingers]),
            finger_qvel=_index(model.jnt_dofadr[fingers]),
            finger_ctrl=_index(np.array(finger_actuators)),
        )


class SimRobot:
    """An arm with its gripper in a world. Arrays are (*world.leading, n)."""

    def __init__(self, world: World, robot: RobotPlacement, *, is_led: bool = True) -> None:
        """Look the robot up in a world and register its TCP pose for readout.

        Args:
            world: The world.
            robot: A robot of its scene.
            is_led: The robot's motion leads the arm; False leaves the world's controls to the caller.
        """
        self.world = world
        self.placement = robot
        self.layout = RobotLayout.of(robot, world.model)
        arm = robot.arm
        ids = self.layout
        springs = springs_of(robot, ids.tcp_site, ids.base_body)
        motion = Motion(ids.joint_ids, ids.actuator_ids, ids.motion, arm.motion_limits, world.copies, springs)
        self.motion = world.core.add_motion(motion) if is_led else motion
        """Leads the arm to its targets."""
        self.tcp_readout = world.core.read_pose(self.layout.tcp_site, self.layout.base_body)
        """Index of the TCP's pose in `world.poses`."""
        self._opening: int | None = None
        if robot.gripper is not None:
            closed, opened = robot.gripper.joint_closed[0], robot.gripper.joint_open[0]
            self._opening = world.core.read_opening(self.layout.finger_joint_ids, closed, opened)
            self._closed = robot.gripper.ctrl_closed
            self._span = robot.gripper.ctrl_open - robot.gripper.ctrl_closed
        world.refresh()

    @property
    def _memory(self) -> NDArray[np.float64]:
        """Live numbers of the arm's motion: targets first, the order to hold last."""
        # Not a view that is kept, which would keep the threads of a closed world.
        memory, first = self.world.userdata, self.layout.motion
        assert memory is not None, "the scene has given every arm its user data"
        return memory[..., first : first + Trajectory.size(self.placement.arm.dof)]

    @property
    def joints(self) -> NDArray[np.float64]:
        """Measured joints [rad], a fresh array."""
        return self.world.qpos[..., self.layout.qpos].copy()

    @property
    def joint_velocities(self) -> NDArray[np.float64]:
        """Measured joint velocities [rad/s], a fresh array."""
        return self.world.qvel[..., self.layout.qvel].copy()

    @property
    def tcp_tquat(self) -> NDArray[np.float64]:
        """Pose of the TCP in the base frame as translation [m] and quaternion xyzw, a fresh array."""
        return self.world.poses[..., self.tcp_readout, :].copy()

    @property
    def tcp_xyzrpy(self) -> NDArray[np.float64]:
        """Pose of the TCP as translation [m] and roll, pitch, yaw [rad]."""
        return self.world.xyzrpy[..., self.tcp_readout, :].copy()

    @property
    def gripper(self) -> GripperDescription:
        """Description of the gripper.

        Raises:
            InvalidSetup: The robot has none.
        """
        if self.placement.gripper is None:
            raise InvalidSetup(f"Robot {self.placement.name!r} has no gripper.")
        return self.placement.gripper

    @property
    def opening(self) -> NDArray[np.float32]:
        """Measured opening of the gripper, 0 closed … 1 open, (*leading, 1).

        Raises:
            InvalidSetup: The robot has no gripper.
        """
        if self._opening is None:
            raise InvalidSetup(f"Robot {self.placement.name!r} has no gripper.")
        return self.world.openings[..., self._opening : self._opening + 1].copy()

    @property
    def hand(self) -> HandDescription:
        """Description of the hand.

        Raises:
            InvalidSetup: The robot has none.
        """
        if self.placement.hand is None:
            raise InvalidSetup(f"Robot {self.placement.name!r} has no hand.")
        return self.placement.hand

    @property
    def hand_joints(self) -> NDArray[np.float32]:
        """Measured joints of the hand, normalised to 0 … 1, (*leading, n)."""
        lower, upper = np.array(self.hand.joint_lower), np.array(self.hand.joint_upper)
        normalised = (self.world.qpos[..., self.layout.finger_qpos] - lower) / (upper - lower)
        return np.clip(normalised, 0.0, 1.0).astype(np.float32)

    def command_hand(self, joints: NDArray[np.floating]) -> None:
        """Set the targets of the hand's joints, normalised to 0 … 1, (*leading, n)."""
        self.world.ctrl[..., self.layout.finger_ctrl] = self.hand.joints_of(joints)

    def command_joints(self, joints: NDArray[np.float64]) -> None:
        """Set the joint targets [rad], (*leading, dof); the arm moves there within its limits."""
        memory = self._memory
        memory[..., : self.placement.arm.dof] = joints
        memory[..., -1] = 0.0

    def stop(self) -> None:
        """Brake the arms of all copies to rest within their limits, from any thread; with copies, between steps."""
        memory = self._memory
        memory[..., : self.placement.arm.dof] = self.joints
        memory[..., -1] = 1.0

    def _place(self, joints: NDArray[np.float64], copies: Copies = None) -> None:
        world, layout = self.world, self.layout
        world.qpos[_at(layout.qpos, copies)] = joints
        world.qvel[_at(layout.qvel, copies)] = 0.0
        is_motor = self.placement.compliance is not None and self.placement.compliance.is_of_tcp
        world.ctrl[_at(np.array(layout.actuator_ids), copies)] = 0.0 if is_motor else joints
        dof, memory = self.placement.arm.dof, self._memory
        memory[_at(slice(0, Trajectory.size(dof)), copies)] = 0.0
        for row in Trajectory.POSITION_ROWS:
            memory[_at(slice(row * dof, (row + 1) * dof), copies)] = joints

    def command_opening(self, opening: NDArray[np.floating]) -> None:
        """Set the gripper's opening, 0 closed … 1 open, (*leading, 1)."""
        if self._opening is None:
            raise InvalidSetup(f"Robot {self.placement.name!r} has no gripper.")
        self.world.ctrl[..., self.layout.finger_ctrl] = self._closed + opening * self._span

    @property
    def opening_target(self) -> NDArray[np.float32]:
        """Target of the gripper's opening, 0 closed … 1 open, (*leading, 1), a fresh array."""
        target = (self.world.ctrl[..., self.layout.finger_ctrl] - self._closed) / self._span
        return np.clip(target, 0.0, 1.0).astype(np.float32)

    def go_home(self) -> None:
        """Put every copy at the home pose with open fingers, at rest, by writing the state (no motion)."""
        self._place(np.array(self.placement.arm.home))
        if (effector := self.placement.end_effector) is not None:
            self._place_fingers(np.array(effector.joint_open), np.array(effector.ctrl_open))

    def _place_fingers(self, joints: NDArray[np.floating], ctrl: NDArray[np.floating], copies: Copies = None) -> None:
        world, layout = self.world, self.layout
        world.qpos[_at(layout.finger_qpos, copies)] = joints
        world.qvel[_at(layout.finger_qvel, copies)] = 0.0
        world.ctrl[_at(layout.finger_ctrl, copies)] = ctrl

    def put(
        self,
        joints: NDArray[np.float64],
        opening: NDArray[np.floating] | None = None,
        hand: NDArray[np.floating] | None = None,
        *,
        copies: Copies = None,
    ) -> None:
        """Put copies at a given position, at rest and with their targets there, by writing the state (no motion).

        Args:
            joints: Joint positions [rad], (*leading, dof).
            opening: Opening of the gripper, 0 closed … 1 open, (*leading, 1); None keeps it.
            hand: Joints of the hand, normalised to 0 … 1, (*leading, n); None keeps them.
            copies: Which copies, whose number is then the leading shape; None for all.

        Raises:
            InvalidSetup: There is an opening but no gripper, or joints of a hand but no hand.
        """
        self._place(joints, copies)
        if opening is not None:
            self._place_fingers(self.gripper.joints_of(opening), self._closed + opening * self._span, copies)
        if hand is not None:
            self._place_fingers(self.hand.joints_of(hand), self.hand.joints_of(hand), copies)

    def wait_for_arrival(self, latency: float = 0.0) -> None:
        """End synchronous steps of the world only when the arm has arrived and the fingers are at rest.

        Args:
            latency: Longest time until fingers get their targets [s].
        """
        core = self.world.core
        core.converge_when(self.motion)
        if fingers := self.layout.finger_joint_ids:
            duration, is_late = REST_TIME + latency, latency > 0.0
            core.converge_when(JointsAtRest(fingers, STILL_TOLERANCE, duration, self.world.copies, is_late))

    def set_load(self, mass: ArrayLike, center_in_flange: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Set the load that the controller carries without sagging, as libfranka's `setLoad` does.

        The motors hold its weight beside their position servos, within their torque limits. Its inertia is not
        compensated. Mounted parts are compensated anyway. The load counts until another is set, 0 for none; a
        recording does not contain it.

        Args:
            mass: Mass of the load [kg], one number or (*leading,).
            center_in_flange: Its centre of mass in the frame of the flange [m], (3,) or (*leading, 3).

        Raises:
            InvalidSetup: A mass is negative, a number is not finite, or something has another shape.
        """
        leading = self.world.leading
        try:
            masses, centers = np.asarray(mass, np.float64), np.asarray(center_in_flange, np.float64)
        except (TypeError, ValueError):
            masses = centers = np.array(np.nan)
        is_number = bool(np.isfinite(masses).all() and np.isfinite(centers).all() and (masses >= 0.0).all())
        if not (is_number and masses.shape in ((), leading) and centers.shape in ((3,), (*leading, 3))):
            per_copy = f", of all {leading[0]} copies or one for each" if leading else ""
            raise InvalidSetup(
                f"The load of robot {self.placement.name!r} has a mass of {mass!r} kg and its centre at "
                f"{center_in_flange!r} m; valid are a mass from 0 and three coordinates, finite numbers{per_copy}."
            )
        body = self.world.model.body(self.placement.prefix + LOAD).id
        self.world.vary("body_ipos")[..., body, :] = centers
        # MuJoCo compensates this factor times the body's own mass.
        self.world.vary("body_gravcomp")[..., body] = masses / LOAD_MASS
        self.world.update_constants()

    def arm(self, copy: int = 0) -> SimArm:
        """Return the arm of one copy as a device, closed."""
        return SimArm(self.placement.name, self.placement.arm.arm_limits, self.world.core, copy, self.motion)

    def gripper_device(self, copy: int = 0) -> SimGripper:
        """Return the gripper of one copy as a device, closed.

        Raises:
            InvalidSetup: The robot has none.
        """
        gripper = self.gripper
        mapping = GripperMap(gripper.joint_closed[0], gripper.joint_open[0], gripper.ctrl_closed, gripper.ctrl_open)
        fingers, actuator = self.layout.finger_joint_ids, self.layout.finger_actuator_ids[0]
        name = f"{self.placement.name} gripper"
        return SimGripper(name, gripper.max_width, gripper.max_force, self.world.core, copy, fingers, actuator, mapping)


def _at(index: Index, copies: Copies) -> tuple[Any, ...]:
    """Return the index of elements of the last axis, of some copies or of all."""
    if copies is None:
        return (..., index)
    return (copies, index) if isinstance(index, slice) else np.ix_(copies, index)


def _index(values: NDArray[np.integer]) -> Index:
    ids = np.asarray(values, np.intp)
    if len(ids) and (np.diff(ids) == 1).all():
        return slice(int(ids[0]), int(ids[-1]) + 1)
    return ids
