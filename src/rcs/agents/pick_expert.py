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
from rcs.envs.setup import Setup
from rcs.envs.spaces import GRIPPER, TQUAT, Observation
from rcs.errors import WrongOrder
from rcs.kinematics import DampedLeastSquares, IkOptions, IkStatus
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
SETTLE_TIME = 0.1
"""Wait before closing [s], for the servo lag to die out."""
STILL = 2e-3
"""The gripper counts as still when its opening changes by less than this per step."""
EMPTY = 0.1
"""An opening below this has nothing in it: the cuboid's short side is 0.4 of the gripper's width."""
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
        self._joints = np.array(observation["joints"])
        self._begin_attempt(info)

    def _begin_attempt(self, info: Mapping[str, Any]) -> None:
        self._attempts += 1
        grasp = self._plan_grasp(np.asarray(info["cuboid"]))
        self._opening = 1.0
        if grasp is None:
            self._failure = "ik"
            self._enter(Phase.GIVEN_UP)
        else:
            self._grasp = grasp
            self._enter(Phase.APPROACH)

    def _plan_grasp(self, cuboid: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the TCP pose that grasps across the short side, with the wrist turned as little as may be."""
        pose = Pose.from_tquat(cuboid)
        across = pose.matrix[:3, 1]  # the cuboid's y axis is its short side
        yaw = float(np.arctan2(-across[0], across[1]))
        best, best_turn = None, np.inf
        for candidate in (yaw, yaw + np.pi):
            # Tool z down, tool y across the cuboid: a half turn about x, then the yaw.
            down = Pose.from_rpy(tuple(pose.translation), (np.pi, 0.0, candidate))
            turn = self._turn_to(down)
            if turn < best_turn:
                best, best_turn = down.tquat, turn
        return best

    def _turn_to(self, grasp: Pose) -> float:
        """Return how far the joints turn to a grasp and its pre-grasp [rad], infinity when one is not feasible."""
        above = Pose((0.0, 0.0, CLEARANCE)) * grasp
        options = IkOptions(restarts=0, iterations=100)
        first = self._kinematics.inverse(above, self._joints, options)
        second = self._kinematics.inverse(grasp, first.joints, options)
        if first.status != IkStatus.ok or second.status != IkStatus.ok:
            return np.inf
        return float(np.abs(second.joints - self._joints).max())

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Go on with the present phase, or with the next when it is done."""
        self._steps += 1
        self._advance(observation, info)
        goal, speed = self._goal()
        step = self._pace * speed * self._period
        self._target = limit_step(self._target, goal, step, self._pace * TURN_SPEED * self._period)
        action = self._writer.write(self._target, self._opening)
        if action is None:
            self._failure = self._failure or "ik"
            action = self._writer.write(np.array(observation[TQUAT]), self._opening)
            assert action is not None, "the present pose is always feasible"
        self._last_opening = float(observation[GRIPPER][0])
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
            is_still = elapsed > SETTLE_TIME and abs(opening - self._last_opening) < STILL
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
        goal, _ = self._goal()
        translation, rotation = distance(np.array(observation[TQUAT]), goal)
        return bool(translation < ARRIVED[0] and rotation < ARRIVED[1])
