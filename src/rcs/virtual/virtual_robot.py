"""A virtual robot: an arm with its gripper in a simulated world, with the interface of motors and sensors."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import UnknownName
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import World
from rcs.virtual.line import Line
from rcs.virtual.robot_log import RobotLog

STILL = 1e-2
"""Speed below which fingers stand still [rad/s, m/s]."""


class VirtualRobot:
    """A robot that a wire moves once per tick of the world. Returned arrays are copies of shape (dof,).

    The last of `lead`, `push` and `brake` counts for each tick. Without a new call, the servos keep their reference,
    torques stay constant, and braking continues.
    """

    def __init__(self, world: World, placement: RobotPlacement, log: RobotLog) -> None:
        """Find the robot in a world.

        Args:
            world: World whose step is one tick.
            placement: Placement of the robot in the scene.
            log: Log for its events and ticks.
        """
        self.name = placement.name
        """Name of the robot in its setup."""
        self.about = placement.arm
        """Description of the arm."""
        self.gripper = placement.gripper
        """Description of the gripper; None without one."""
        self.body = SimRobot(world, placement, is_led=False)
        """The robot's body in the world."""
        self.line = Line()
        """Line that all packets pass."""
        self.frozen_until = 0.0
        """Time at which a hanging controller continues, on the monotonic clock [s]."""
        self.period = world.period
        """Duration of a tick [s]."""
        layout, model, arm = self.body.layout, world.model, placement.arm
        self._world, self._log = world, log
        assert world.data is not None, "the world has one copy"
        self._data = world.data
        self._model = model
        self._qpos, self._qvel = layout.qpos, layout.qvel
        self._actuators = np.array(layout.actuator_ids)
        self._gain = model.actuator_gainprm[self._actuators].copy()
        self._bias = model.actuator_biasprm[self._actuators].copy()
        stiffness = -self._bias[:, 1]
        damping = model.dof_damping[model.jnt_dofadr[layout.joint_ids]]
        self._lag = (damping - self._bias[:, 2]) / stiffness  # lag of a servo that receives positions only [s]
        self._stiffness = stiffness
        self._effort = np.array(arm.effort_limit)
        joints = layout.joint_ids
        has_limit = model.jnt_actfrclimited[joints].astype(bool)[:, None]
        self._torque_range = np.where(has_limit, model.jnt_actfrcrange[joints], self._effort[:, None] * [-1.0, 1.0])
        model.jnt_actfrclimited[joints] = True
        self.limit(np.ones(arm.dof))
        self._slowing = np.array(arm.acceleration_limit)
        self._force = np.zeros(model.nv)
        self._wanted = np.zeros(model.nv)
        if self.gripper is not None:
            (finger,) = layout.finger_actuator_ids
            limits: list[tuple[Any, Any]] = [(model.actuator_forcerange, finger)]
            limits += [(model.jnt_actfrcrange, joint) for joint in layout.finger_joint_ids]
            self._grip_limits = [(array, at, array[at].copy()) for array, at in limits]
        self._pressed: NDArray[np.float64] | None = None  # [N], in the world
        self._opening = self._opening_goal = 1.0  # as at the beginning of an episode
        self._opening_speed = 0.0
        self.rest()

    # --- Measurements at the end of the last tick ---

    @property
    def joints(self) -> NDArray[np.float64]:
        """Joint positions [rad]."""
        return self._data.qpos[self._qpos].copy()

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Joint velocities [rad/s]."""
        return self._data.qvel[self._qvel].copy()

    @property
    def torques(self) -> NDArray[np.float64]:
        """Motor torques including gravity compensation [N·m]."""
        return self._data.qfrc_actuator[self._qvel] + self._data.qfrc_applied[self._qvel]

    @property
    def pose_tcp_in_base(self) -> NDArray[np.float64]:
        """Pose of the TCP in the base, shape (7,): translation [m], quaternion xyzw."""
        return self.body.tcp_tquat

    @property
    def width(self) -> float:
        """Width of the gripper [m]; NaN without one."""
        return np.nan if self.gripper is None else float(self.body.opening[0]) * self.gripper.max_width

    @property
    def grip_force(self) -> float:
        """Force per finger of the gripper's motor [N]; NaN without one."""
        if self.gripper is None:
            return np.nan
        finger, at = self.body.layout.finger_joint_ids[0], self.body.layout.finger_actuator_ids[0]
        if self._model.jnt_actfrclimited[finger]:
            force, (_, _, limit) = self._data.qfrc_actuator[self._model.jnt_dofadr[finger]], self._grip_limits[1]
        else:
            force, (_, _, limit) = self._data.actuator_force[at], self._grip_limits[0]
        return float(abs(force) / limit[1]) * self.gripper.grasp_force

    @property
    def is_grip_still(self) -> bool:
        """True if the fingers stand still, at their target or on an object."""
        fastest = float(np.abs(self._data.qvel[self.body.layout.finger_qvel]).max(initial=0.0))
        return abs(self._opening - self._opening_goal) < 1e-6 and fastest < STILL

    @property
    def is_frozen(self) -> bool:
        """True while the controller hangs."""
        return time.monotonic() < self.frozen_until

    # --- Commands ---

    @property
    def commanded(self) -> NDArray[np.float64]:
        """Reference of the servos [rad], shape (dof,); NaN while torques are commanded."""
        return np.full(self.about.dof, np.nan) if self._is_pushed else self._position.copy()

    def lead(
        self, joints: ArrayLike, velocities: ArrayLike | None = None, accelerations: ArrayLike | None = None
    ) -> None:
        """Set the servos' reference for the end of the next tick.

        With velocities and accelerations, the servos do not lag, like in the simulation's own motions. The robot brakes
        for values that are not finite.

        Args:
            joints: Positions [rad].
            velocities: Velocities [rad/s]; None for 0, with which the servos lag.
            accelerations: Accelerations [rad/s²]; None for 0.
        """
        position = np.array(joints, np.float64)
        velocity = np.zeros_like(position) if velocities is None else np.array(velocities, np.float64)
        acceleration = None if accelerations is None else np.array(accelerations, np.float64)
        if not np.isfinite(position + velocity + (0.0 if acceleration is None else acceleration)).all():
            if not self._is_braking:
                self.note("not_finite", joints=str(position))
            self.brake()
            return
        self._stop_pushing()
        self._is_braking = False
        self._position, self._velocity, self._acceleration = position, velocity, acceleration
        self._is_led = True

    def push(self, torques: ArrayLike) -> None:
        """Command motor torques in addition to gravity compensation [N·m], clipped to the motors' limits."""
        if not self._is_pushed:
            self._model.actuator_gainprm[self._actuators] = 0.0
            self._model.actuator_biasprm[self._actuators] = 0.0
            self._is_pushed = True
        self._is_braking = False
        self._data.qfrc_applied[self._qvel] = np.clip(np.asarray(torques, np.float64), -self._effort, self._effort)

    def brake(self) -> None:
        """Brake at the largest accelerations and stay at rest."""
        self._stop_pushing()
        self._is_braking = True

    def limit(self, shares: ArrayLike) -> None:
        """Limit the motors to fractions of their torques, shape (dof,): 1 for no limit, 0 for a motor without power.

        The limit includes gravity compensation, so a joint without power falls.
        """
        torques = np.asarray(shares, np.float64)[:, None] * self._torque_range
        self._model.jnt_actfrcrange[self.body.layout.joint_ids] = torques

    def rest(self) -> None:
        """Set the servos' reference to the measured positions; the gripper keeps its width."""
        self._is_pushed = self._is_led = self._is_braking = False
        self._data.qfrc_applied[self._qvel] = 0.0
        self._model.actuator_gainprm[self._actuators] = self._gain
        self._model.actuator_biasprm[self._actuators] = self._bias
        self._position, self._velocity, self._acceleration = self.joints, np.zeros(self.about.dof), None
        self._data.ctrl[self._actuators] = self._position

    def press(self, force: ArrayLike) -> None:
        """Apply an external force at the TCP from the next tick on.

        Args:
            force: Force in the base [N], shape (3,); 0 for none.
        """
        body = self._data.body(self.body.layout.base_body)
        self._pressed = body.xmat.reshape(3, 3) @ np.asarray(force, np.float64)

    def move(self, width: float, speed: float | None = None) -> None:
        """Move the gripper to a width [m] at a speed of the width [m/s], None for the largest, with full force."""
        self.grasp(width, speed, None)

    def grasp(self, width: float, speed: float | None, force: float | None) -> None:
        """Move the gripper to a width with limited force.

        Args:
            width: Width [m].
            speed: Speed of the width [m/s]; None for the largest.
            force: Largest force per finger [N]; None for full force.

        Raises:
            InvalidSetup: The robot has no gripper.
        """
        gripper = self.body.gripper
        fastest = 2.0 * gripper.closing_speed
        share = 1.0 if force is None else min(force / gripper.grasp_force, 1.0)
        for array, at, limit in self._grip_limits:
            array[at] = share * limit
        self._opening_goal = float(np.clip(width / gripper.max_width, 0.0, 1.0))
        self._opening_speed = min(fastest if speed is None else speed, fastest) / gripper.max_width

    def joint_of(self, text: str) -> int:
        """Return the index of a joint from its name or its number, starting at 0.

        Raises:
            UnknownName: There is no such joint.
        """
        if text in self.about.joints:
            return self.about.joints.index(text)
        if text.isdigit() and int(text) < self.about.dof:
            return int(text)
        raise UnknownName("joint", text, self.about.joints)

    def note(self, event: str, **values: Any) -> None:
        """Log an event with JSON-compatible values."""
        self._log.note(self.name, event, **values)

    def log_point(self, *, joints: ArrayLike = np.nan, torques: ArrayLike = np.nan) -> None:
        """Log a received setpoint: joints [rad] or torques [N·m], shape (dof,)."""
        everywhere = np.ones(self.about.dof)
        self._log.point(self.name, np.asarray(joints) * everywhere, np.asarray(torques) * everywhere)

    # --- Calls of the world's loop ---

    def settle(self) -> None:
        """Write the controls of the next tick."""
        if self._is_pushed and self.is_frozen:
            self.brake()  # as drives do that receive no torques any more
        if self._is_braking:
            self._slow_down()
        elif not self._is_led:  # no new command: keep the reference, without its velocity
            self._velocity, self._acceleration = np.zeros_like(self._velocity), None
        self._is_led = False
        if not self._is_pushed:
            controls = self._position + self._lag * self._velocity
            if self._acceleration is not None:
                self._wanted[self._qvel] = self._acceleration
                mujoco.mj_mulM(self._model, self._data, self._force, self._wanted)
                controls += self._force[self._qvel] / self._stiffness
            self._data.ctrl[self._actuators] = controls
        if self._pressed is not None:
            site, applied = self._data.site(self.body.layout.tcp_site), self._data.xfrc_applied
            body = self._model.site_bodyid[site.id]
            applied[body, :3], applied[body, 3:] = (
                self._pressed,
                np.cross(site.xpos - self._data.xipos[body], self._pressed),
            )
            if not self._pressed.any():
                self._pressed = None
        if self.gripper is not None:
            step = self._opening_speed * self.period
            self._opening += min(max(self._opening_goal - self._opening, -step), step)
            self.body.command_opening(np.array([self._opening]))

    def log_tick(self, due: float, began: float) -> None:
        """Log the last tick."""
        row = (due, began, self.commanded, self.joints, self.velocities, self.torques, self.width)
        self._log.tick(self.name, row)

    def _slow_down(self) -> None:
        step = self._slowing * self.period
        slower = self._velocity - np.clip(self._velocity, -step, step)
        self._position = self._position + 0.5 * (self._velocity + slower) * self.period
        self._acceleration = (slower - self._velocity) / self.period
        self._velocity = slower

    def _stop_pushing(self) -> None:
        if self._is_pushed:
            self._data.qfrc_applied[self._qvel] = 0.0
            self._model.actuator_gainprm[self._actuators] = self._gain
            self._model.actuator_biasprm[self._actuators] = self._bias
            self._position, self._velocity, self._acceleration = self.joints, self.velocities, None
            self._is_pushed = False
