"""A scripted expert for Pick-Cuboid: from above, across the short side, and with a look at what the gripper feels."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Action, Agent
from rcs.agents.grasp import GraspPlan, plan_top_grasp
from rcs.envs.setup import Setup
from rcs.envs.spaces import GRIPPER, JOINTS, TQUAT, Observation
from rcs.errors import WrongOrder
from rcs.kinematics import DampedLeastSquares
from rcs.spatial import Pose, distance, limit_step

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]."""
LIFT = 0.15
"""Height to lift to above the grasp [m]: the task wants 0.10."""
APPROACH_SPEED = 0.45
DESCENT_SPEED = 0.20
LIFT_SPEED = 0.20
"""Speeds of the target [m/s]; slower near the object and with it."""
TURN_SPEED = 2.0
"""Speed of the target's rotation [rad/s]."""
ARRIVED = (0.004, 0.03)
"""The TCP counts as arrived this close to its target [m, rad]; the cuboid is 5 cm narrower than the gripper opens."""
JOINT_SPEED = 1.2
"""Speed of the fastest joint where the way is by joints [rad/s]."""
ARRIVED_JOINTS = 0.03
"""Joints count as arrived this close to their targets [rad]."""
SETTLE_TIME = 0.1
"""Wait before closing [s], for the servo lag to die out."""
CLOSING_TIME = 0.3
"""A gripper that stands still sooner than this after the command to close [s] has not yet begun to."""
BARELY_CLOSED = 0.9
"""Nothing that is to be grasped here is this wide in proportion to the gripper."""
STILL = 2e-3
"""The gripper counts as still when its opening changes by less than this per step."""
EMPTY = 0.05
"""An opening below this has nothing in it: empty jaws close to 0, and those of an SO101 on its cuboid to 0.1."""
PATIENCE = 4.0
"""Longest time of any phase before the expert goes on regardless [s]."""
ATTEMPTS = 2
"""How often to try."""


class Phase(Enum):
    """What the expert is doing."""

    APPROACH = "approach"
    DESCEND = "descend"
    SETTLE = "settle"
    CLOSE = "close"
    LIFT = "lift"
    HOLD = "hold"
    RETREAT = "retreat"
    GIVEN_UP = "given up"


class PickExpert(Agent):
    """Picks the cuboid whose pose is in `info["cuboid"]`, by the same actions that a policy would send."""

    def __init__(self, setup: Setup, action_space: spaces.Dict, kinematics: DampedLeastSquares) -> None:
        """Act in an environment.

        Args:
            setup: The environment's setup.
            action_space: The environment's action space.
            kinematics: Of the arm with its gripper.
        """
        self._period = 1.0 / setup.frequency
        # A synchronous step ends at its target: there, bigger steps only mean fewer of them.
        self._pace = 1.0 if setup.mode != "sync" else 3.0
        self._kinematics = kinematics
        self._writer = ActionWriter(setup, action_space, kinematics)
        self._failure: str | None = None
        self._phase = Phase.APPROACH
        self._grasp = np.zeros(7)
        self._target = np.zeros(7)
        self._opening = 1.0
        self._last_opening = 1.0
        self._steps = 0
        self._attempts = 0
        self._joints = np.zeros(kinematics.dof)
        self._plan: GraspPlan | None = None
        # Between two poses an arm with five joints can reach there are poses that it can not: it goes by joints.
        self._goes_by_joints = kinematics.dof < 6

    @property
    def failure(self) -> str | None:
        """`ik`: no grasp is feasible; `no_contact`: the gripper closed on nothing; `slip`: it lost the cuboid."""
        return self._failure

    @property
    def phase(self) -> Phase:
        """What the expert is doing."""
        return self._phase

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan the grasp of a new episode.

        Raises:
            WrongOrder: The info has no cuboid: this is not Pick-Cuboid.
        """
        if "cuboid" not in info:
            raise WrongOrder("PickExpert needs info['cuboid'], the pose of the cuboid; use it in the task PickCuboid.")
        self._writer.reset(observation)
        self._failure = None
        self._attempts = 0
        self._target = np.array(observation[TQUAT])
        self._joints = np.array(observation[JOINTS])
        self._begin_attempt(info)

    def _begin_attempt(self, info: Mapping[str, Any]) -> None:
        self._attempts += 1
        cuboid = Pose.from_tquat(info["cuboid"])
        # Across the short side: the cuboid's y axis.
        across = cuboid.matrix[:3, 1]
        plan = plan_top_grasp(cuboid, across, self._joints, self._kinematics, CLEARANCE, LIFT)
        self._opening = 1.0
        if plan is None:
            self._failure = "ik"
            self._enter(Phase.GIVEN_UP)
        else:
            self._plan = plan
            self._grasp = plan.tcp
            self._enter(Phase.APPROACH)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Go on with the present phase, or with the next when it is done."""
        self._steps += 1
        self._writer.follow(info)
        self._advance(observation, info)
        joints = self._joint_goal()
        if joints is not None:
            action = self._step_joints(joints)
        else:
            goal, speed = self._goal()
            step = self._pace * speed * self._period
            self._target = limit_step(self._target, goal, step, self._pace * TURN_SPEED * self._period)
            action = self._writer.write(self._target, self._opening)
            if action is None:
                self._failure = self._failure or "ik"
                action = self._writer.write_joints(self._writer.joints, self._opening)
        self._last_opening = float(observation[GRIPPER][0])
        return action

    def _joint_goal(self) -> NDArray[np.float64] | None:
        """Return the joints to go to, where the way is by joints."""
        if not self._goes_by_joints or self._plan is None:
            return None
        if self._phase in (Phase.APPROACH, Phase.RETREAT):
            return self._plan.joints_above
        return self._plan.joints_lifted if self._phase in (Phase.LIFT, Phase.HOLD) else None

    def _step_joints(self, goal: NDArray[np.float64]) -> Action:
        step = goal - self._writer.joints
        most = self._pace * JOINT_SPEED * self._period
        step = step * min(1.0, most / max(float(np.abs(step).max()), 1e-12))
        action = self._writer.write_joints(self._writer.joints + step, self._opening)
        self._target = self._kinematics.forward(self._writer.joints).tquat
        return action

    def _goal(self) -> tuple[NDArray[np.float64], float]:
        if self._phase is Phase.GIVEN_UP:
            return self._target, 0.0
        goal = self._grasp.copy()
        if self._phase in (Phase.APPROACH, Phase.RETREAT):
            goal[2] += CLEARANCE
            return goal, APPROACH_SPEED
        if self._phase in (Phase.LIFT, Phase.HOLD):
            goal[2] += LIFT
            return goal, LIFT_SPEED
        return goal, DESCENT_SPEED

    def _advance(self, observation: Observation, info: Mapping[str, Any]) -> None:
        opening = float(observation[GRIPPER][0])
        elapsed = self._steps * self._period
        is_late = elapsed > PATIENCE
        if self._phase is Phase.APPROACH and (self._has_arrived(observation) or is_late):
            self._enter(Phase.DESCEND)
        elif self._phase is Phase.DESCEND and (self._has_arrived(observation) or is_late):
            self._enter(Phase.SETTLE)
        elif self._phase is Phase.SETTLE and elapsed >= SETTLE_TIME:
            self._opening = 0.0
            self._enter(Phase.CLOSE)
        elif self._phase is Phase.CLOSE:
            is_moved = elapsed > CLOSING_TIME and opening < BARELY_CLOSED
            is_still = is_moved and abs(opening - self._last_opening) < STILL
            if (is_still or is_late) and opening < EMPTY:
                self._give_up("no_contact")
            elif is_still or is_late:
                self._enter(Phase.LIFT)
        elif self._phase is Phase.LIFT and (self._has_arrived(observation) or is_late):
            self._enter(Phase.HOLD)
        elif self._phase is Phase.RETREAT and (self._has_arrived(observation) or is_late):
            self._begin_attempt(info)
        if self._phase in (Phase.LIFT, Phase.HOLD) and opening < EMPTY:
            self._give_up("slip")

    def _give_up(self, why: str) -> None:
        """Try again from above, or remember why not."""
        self._failure = why
        self._opening = 1.0
        self._enter(Phase.RETREAT if self._attempts < ATTEMPTS else Phase.GIVEN_UP)

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._steps = 0

    def _has_arrived(self, observation: Observation) -> bool:
        joints = self._joint_goal()
        if joints is not None:
            return bool(np.abs(np.asarray(observation[JOINTS]) - joints).max() < ARRIVED_JOINTS)
        goal, _ = self._goal()
        translation, rotation = distance(np.array(observation[TQUAT]), goal)
        return bool(translation < ARRIVED[0] and rotation < ARRIVED[1])
