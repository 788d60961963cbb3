"""Turns the wishes of a person for one robot, a pose or joints and an opening, into actions of its environment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, JOINT_VELOCITIES, JOINTS, TQUAT, XYZYAW, Action, Observation
from rcs.envs.start import base_in_scene
from rcs.errors import InvalidSetup
from rcs.kinematics import Kinematics, kinematics_of
from rcs.sim.scene import RobotPlacement
from rcs.spatial import compose, distance, inverse, limit_step

SPEED = 0.84 * 0.25
"""Speed at which the TCP's target moves [m/s]. The TCP exceeds it by up to 19 % where it catches up, and so keeps to
the 0.25 m/s of collaborative robots under a person's hand (ISO 10218-1)."""

TURN_SPEED = 1.5
"""Rotational speed of the TCP's target [rad/s]."""

ACCELERATION = 2.0, 12.0
"""Acceleration of the target [m/s², rad/s²]: an arm that falls behind an abrupt one catches up faster than it may."""

LEAD = 0.1
"""Longest way of the target before the TCP [m], so that it comes back at once from where the arm cannot follow."""

STILL = 0.02, 1.0
"""An arm that brakes is at rest once no joint is faster than this [rad/s], or after this time [s]."""

STUCK = 0.002, 0.01, 1.0
"""An arm is stuck after moving less than this [m] while farther from its goal than this [m] for this time [s]."""

JOINT_SPEED = 0.5
"""Share of the joints' velocity limits at which joint targets move."""


class Guide:
    """Leads one robot to a wanted pose or wanted joints, at a bounded speed, step by step."""

    def __init__(
        self, env: Env, robot: RobotPlacement, *, speed: float = SPEED, turn_speed: float = TURN_SPEED
    ) -> None:
        """Prepare to lead a robot.

        Args:
            env: Its environment, with a setup.
            robot: The robot.
            speed: Speed at which the TCP's target moves [m/s].
            turn_speed: Rotational speed of the TCP's target [rad/s].

        Raises:
            InvalidSetup: A layer has given the robot actions that only a policy can make.
        """
        self.robot = robot
        self.kinematics: Kinematics = kinematics_of(robot.arm, robot.end_effector)
        self._key = None if len(env.robots) == 1 else robot.name
        every: Any = env.action_space
        space = every if self._key is None else every[self._key]
        arm = XYZYAW if XYZYAW in space.spaces else env.setup.control
        valid = {arm} | ({GRIPPER} if robot.end_effector is not None else set())
        if set(space.keys()) != valid:
            raise InvalidSetup(
                f"Actions of {robot.name!r} have the keys {sorted(space.keys())}; a person can lead it with the keys "
                f"{sorted(valid)}. Leave out the layers that change them."
            )
        self._writer = ActionWriter(env.setup, space, self.kinematics)
        self._is_jointwise = env.setup.control == JOINTS
        self._period = 1.0 / env.frequency
        self._fastest = speed, turn_speed
        self._joint_step = JOINT_SPEED * np.array(robot.arm.velocity_limit) * self._period
        self.joint_pace = 1.0
        """Share of `JOINT_SPEED` at which joint targets move."""
        box = env.stack.chains[self._key or ""].joint_space
        assert box is not None, "a robot has an arm"
        self.lower, self.upper = box.low.astype(np.float64), box.high.astype(np.float64)
        """Limits of the joints [rad], (dof,)."""
        self._base = base_in_scene([robot])
        self.has_opening = robot.end_effector is not None
        """True if there is a gripper or a hand to open and close."""
        effector = robot.end_effector
        origin = None if effector is None else env.platform.get(f"{robot.name}/{effector.name}")
        self._sent_to = None if origin in ("simulation", None) else env.stack
        """Knows the last command to a real gripper or hand, which an episode leaves alone."""
        self.opening = 1.0
        """Wanted opening, 0 closed … 1 open."""
        self.is_out_of_reach = False
        """True if the arm cannot get to the wanted pose."""
        self._measured: Observation = {}
        self._goal = self._target = np.zeros(7)
        self._joint_goal: NDArray[np.float64] | None = None
        self._joints = np.zeros(robot.arm.dof)
        self._place, self._still = np.zeros(3), 0
        self._braking: int | None = None
        self._velocity, self._turn_rate = np.zeros(3), 0.0

    def reset(self, observation: Observation) -> None:
        """Stay at the pose and the opening of an observation; a real gripper keeps the last command to it.

        Args:
            observation: The first one of an episode, or the last one.
        """
        own = self._own(observation)
        self._writer.reset(own)
        self._measured = own
        self._goal = self._target = np.array(own[TQUAT])
        self._joints, self._joint_goal, self._braking = np.array(own[JOINTS]), None, None
        self._velocity, self._turn_rate = np.zeros(3), 0.0
        self.opening = float(own[GRIPPER][0]) if GRIPPER in own else 1.0
        if self._sent_to is not None:  # what it holds keeps it from closing all the way, and would fall
            for sent in (self._sent_to.target, self._sent_to.executed):  # the way to a start goes past the layers
                self.keep_opening({"target": sent})
        self.is_out_of_reach = False

    def keep_opening(self, info: Mapping[str, Any]) -> None:
        """Want the opening that the last step commanded, not the measured one, so that nothing falls.

        Args:
            info: Info of that step; without a target, nothing changes.
        """
        target = info.get("target", {})
        own = target if self._key is None else target.get(self._key, {})
        if GRIPPER in own:
            self.opening = float(own[GRIPPER][0])

    def see(self, observation: Observation) -> None:
        """Take the present observation, of the whole environment."""
        self._measured = self._own(observation)
        if self._braking == 0:
            self._want_measured()

    @property
    def is_by_joints(self) -> bool:
        """True if joints are wanted, not a pose."""
        return self._joint_goal is not None

    @property
    def joints(self) -> NDArray[np.float64]:
        """Wanted joints, or the measured ones if a pose is wanted [rad], (dof,)."""
        found = self._measured[JOINTS] if self._joint_goal is None else self._joint_goal
        return np.clip(found, self.lower, self.upper)

    @property
    def measured_joints(self) -> NDArray[np.float64]:
        """Measured joints [rad], (dof,)."""
        return self._measured[JOINTS]

    @property
    def target_joints(self) -> NDArray[np.float64]:
        """Present target of the joints [rad], (dof,)."""
        return self._writer.joints if self._joint_goal is None else self._joints

    @property
    def goal_in_scene(self) -> NDArray[np.float64]:
        """Wanted pose of the TCP in the scene, (7,): [m], xyzw."""
        return compose(self._base, self._goal)

    @property
    def target_in_scene(self) -> NDArray[np.float64]:
        """Present target of the TCP on its way to the wanted pose, in the scene, (7,): [m], xyzw."""
        return compose(self._base, self._target if self._joint_goal is None else self._goal_of(self._joints))

    @property
    def tcp_in_scene(self) -> NDArray[np.float64]:
        """Measured pose of the TCP in the scene, (7,): [m], xyzw."""
        return compose(self._base, self._measured[TQUAT])

    def lead_to(self, pose_in_scene: NDArray[np.float64]) -> None:
        """Lead the TCP to a pose in the scene, (7,): [m], xyzw."""
        if self._joint_goal is not None:
            self._target, self._joint_goal, self._braking = self._goal_of(self._joints), None, None
            self._velocity, self._turn_rate = np.zeros(3), 0.0
        self._goal = compose(inverse(self._base), pose_in_scene)
        self._still = 0

    def lead_joints_to(self, joints: NDArray[np.float64]) -> None:
        """Lead the arm to joints [rad], (dof,); they are cut to the limits."""
        if self._joint_goal is None:
            self._joints = np.array(self._writer.joints if self._is_jointwise else self._measured[JOINTS])
        self._joint_goal, self._braking = np.clip(joints, self.lower, self.upper), None
        self._goal, self.is_out_of_reach = self._goal_of(self._joint_goal), False

    def stay(self) -> None:
        """Stay at the present pose of the TCP."""
        self.lead_to(self.tcp_in_scene)

    def brake(self) -> None:
        """Come to rest at once, and stay there: the target is where the arm is measured until it stands still."""
        if self._braking is None:
            self._braking, self._joint_goal = 0, self._joints
            if self._measured:  # who leads it before the next action begins there, not where it braked before
                self._want_measured()

    @property
    def is_braking(self) -> bool:
        """Whether it brakes, or has braked and stays."""
        return self._braking is not None

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the robot's next action.

        Args:
            observation: The present one, of the whole environment.
            info: Info of the last step.
        """
        self.see(observation)
        self._writer.follow(info, self._key)
        if self._braking is not None:
            self._brake_on()
        if self._joint_goal is not None:
            way = self._joint_goal - self._joints
            # All joints are scaled alike, so that they move in a straight line and arrive together.
            step = self.joint_pace * self._joint_step
            self._joints = self._joints + way / max(1.0, float((np.abs(way) / step).max()))
            return self._writer.write_joints(self._joints, self.opening)
        target = self._next_target()
        place = self._measured[TQUAT][:3]
        ahead = target[:3] - place
        target[:3] = place + ahead * min(1.0, LEAD / max(float(np.linalg.norm(ahead)), LEAD))
        action = self._writer.write(target, self.opening)
        status = info.get("ik_status" if self._key is None else f"{self._key}/ik_status", 0)
        self.is_out_of_reach = action is None or int(status) != 0 or self._is_stuck(place)
        if action is None:
            return self._writer.write_joints(self._writer.joints, self.opening)
        self._target = target
        return action

    def _next_target(self) -> NDArray[np.float64]:
        """Return the next target on the way to the goal, at speeds from which it stops there."""
        period, (speed, turn_speed), (hardest, quickest) = self._period, self._fastest, ACCELERATION
        way = self._goal[:3] - self._target[:3]
        far, angle = (float(one) for one in distance(self._target, self._goal))
        fastest = min(speed, _from_rest(far, hardest, period))
        wanted = way / max(far / fastest, period) if far > 0.0 else way
        change = wanted - self._velocity
        self._velocity = self._velocity + change / max(1.0, float(np.linalg.norm(change)) / (hardest * period))
        rate = min(turn_speed, _from_rest(angle, quickest, period), self._turn_rate + quickest * period)
        target = limit_step(self._target, self._goal, np.inf, rate * period)
        self._turn_rate = min(rate, angle / period)
        target[:3] = self._target[:3] + self._velocity * period
        return target

    def _brake_on(self) -> None:
        """Have the arm come to rest where it is measured, as long as it moves."""
        assert self._braking is not None, "it brakes"
        speed, seconds = STILL
        if self._braking * self._period <= seconds:
            self._braking += 1
            self._want_measured()
            if np.abs(self._measured[JOINT_VELOCITIES]).max() < speed:
                self._braking = math.ceil(seconds / self._period) + 1

    def _want_measured(self) -> None:
        """Take the measured joints for the wanted ones, and for their target."""
        self._joints = self._joint_goal = np.clip(self._measured[JOINTS], self.lower, self.upper)
        self._goal = self._goal_of(self._joints)

    def _is_stuck(self, place: NDArray[np.float64]) -> bool:
        """Return whether the TCP, at a place in the base frame, has come to rest away from the goal."""
        least, near, seconds = STUCK
        if np.linalg.norm(place - self._place) > least:
            self._place, self._still = np.array(place), 0
        self._still += 1
        return self._still * self._period > seconds and bool(np.linalg.norm(place - self._goal[:3]) > near)

    def _own(self, observation: Observation) -> Observation:
        return observation if self._key is None else observation[self._key]

    def _goal_of(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(self.kinematics.forward(joints).tquat)


def _from_rest(way: float, acceleration: float, period: float) -> float:
    """Return the speed at which something stops within a way, in steps of a period [s]."""
    slowest = acceleration * period
    return max(math.sqrt(2.0 * acceleration * way + 0.25 * slowest**2) - 0.5 * slowest, 1e-9)
