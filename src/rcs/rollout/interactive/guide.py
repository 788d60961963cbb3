"""Turns the wishes of a person for one robot, a pose or joints and an opening, into actions of its environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, JOINTS, TQUAT, XYZYAW, Action, Observation
from rcs.errors import InvalidSetup
from rcs.kinematics import Kinematics, kinematics_of
from rcs.sim.scene import RobotPlacement
from rcs.spatial import compose, inverse, limit_step

SPEED = 0.25
"""Speed at which the TCP's target moves [m/s], that of collaborative robots under a person's hand (ISO 10218-1)."""

TURN_SPEED = 1.5
"""Rotational speed of the TCP's target [rad/s]."""

LEAD = 0.1
"""Longest way of the target before the TCP [m], so that it comes back at once from where the arm cannot follow."""

STUCK = 0.002, 0.01, 1.0
"""An arm is stuck after moving less than this [m] while farther from its goal than this [m] for this time [s]."""

JOINT_SPEED = 0.5
"""Share of the joints' velocity limits at which joint targets move."""


class Guide:
    """Leads one robot to a wanted pose or wanted joints, at a bounded speed, step by step."""

    def __init__(self, env: Env, robot: RobotPlacement) -> None:
        """Prepare to lead a robot.

        Args:
            env: Its environment, with a setup.
            robot: The robot.

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
        self._joint_step = JOINT_SPEED * np.array(robot.arm.velocity_limit) * self._period
        box = env.stack.chains[self._key or ""].joint_space
        assert box is not None, "a robot has an arm"
        self.lower, self.upper = box.low.astype(np.float64), box.high.astype(np.float64)
        """Limits of the joints [rad], (dof,)."""
        base = robot.base_in_scene
        self._base = np.array([*base.translation, *base.quaternion])
        self.has_opening = robot.end_effector is not None
        """True if there is a gripper or a hand to open and close."""
        self.opening = 1.0
        """Wanted opening, 0 closed … 1 open."""
        self.is_out_of_reach = False
        """True if the arm cannot get to the wanted pose."""
        self._measured: Observation = {}
        self._goal = self._target = np.zeros(7)
        self._joint_goal: NDArray[np.float64] | None = None
        self._joints = np.zeros(robot.arm.dof)
        self._place, self._still = np.zeros(3), 0

    def reset(self, observation: Observation) -> None:
        """Stay at the pose and the opening of an observation.

        Args:
            observation: The first one of an episode, or the last one.
        """
        own = self._own(observation)
        self._writer.reset(own)
        self._measured = own
        self._goal = self._target = np.array(own[TQUAT])
        self._joints, self._joint_goal = np.array(own[JOINTS]), None
        self.opening = float(own[GRIPPER][0]) if GRIPPER in own else 1.0
        self.is_out_of_reach = False

    def see(self, observation: Observation) -> None:
        """Take the present observation, of the whole environment."""
        self._measured = self._own(observation)

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
    def goal_in_scene(self) -> NDArray[np.float64]:
        """Wanted pose of the TCP in the scene, (7,): [m], xyzw."""
        return compose(self._base, self._goal)

    @property
    def tcp_in_scene(self) -> NDArray[np.float64]:
        """Measured pose of the TCP in the scene, (7,): [m], xyzw."""
        return compose(self._base, self._measured[TQUAT])

    def lead_to(self, pose_in_scene: NDArray[np.float64]) -> None:
        """Lead the TCP to a pose in the scene, (7,): [m], xyzw."""
        if self._joint_goal is not None:
            self._target, self._joint_goal = self._goal_of(self._joints), None
        self._goal = compose(inverse(self._base), pose_in_scene)
        self._still = 0

    def lead_joints_to(self, joints: NDArray[np.float64]) -> None:
        """Lead the arm to joints [rad], (dof,); they are cut to the limits."""
        if self._joint_goal is None:
            self._joints = np.array(self._writer.joints if self._is_jointwise else self._measured[JOINTS])
        self._joint_goal = np.clip(joints, self.lower, self.upper)
        self._goal, self.is_out_of_reach = self._goal_of(self._joint_goal), False

    def stay(self) -> None:
        """Stay at the present pose of the TCP."""
        self.lead_to(self.tcp_in_scene)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the robot's next action.

        Args:
            observation: The present one, of the whole environment.
            info: Info of the last step.
        """
        self.see(observation)
        self._writer.follow(info, self._key)
        if self._joint_goal is not None:
            way = self._joint_goal - self._joints
            # All joints are scaled alike, so that they move in a straight line and arrive together.
            self._joints = self._joints + way / max(1.0, float((np.abs(way) / self._joint_step).max()))
            return self._only_own_keys(self._writer.write_joints(self._joints, self.opening))
        target = limit_step(self._target, self._goal, SPEED * self._period, TURN_SPEED * self._period)
        place = self._measured[TQUAT][:3]
        ahead = target[:3] - place
        target[:3] = place + ahead * min(1.0, LEAD / max(float(np.linalg.norm(ahead)), LEAD))
        action = self._writer.write(target, self.opening)
        status = info.get("ik_status" if self._key is None else f"{self._key}/ik_status", 0)
        self.is_out_of_reach = action is None or int(status) != 0 or self._is_stuck(place)
        if action is None:
            return self._only_own_keys(self._writer.write_joints(self._writer.joints, self.opening))
        self._target = target
        return self._only_own_keys(action)

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

    def _only_own_keys(self, action: Action) -> Action:
        return action if self.has_opening else {key: value for key, value in action.items() if key != GRIPPER}
