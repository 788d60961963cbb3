"""A scripted expert for Pick-Toy: from above with the palm down, a power grasp, and back to the home pose."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Action, Agent
from rcs.agents.grasp import freedom_of
from rcs.agents.pick_expert import APPROACH_SPEED, DESCENT_SPEED, LIFT_SPEED, PATIENCE, SETTLE_TIME
from rcs.envs.setup import Setup
from rcs.envs.spaces import JOINTS, TQUAT, Observation
from rcs.errors import WrongOrder
from rcs.kinematics import DampedLeastSquares, IkStatus
from rcs.spatial import Pose, distance, limit_step

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]: the fingertips of the open hand are then above the toy."""
LIFT = 0.10
"""Height to lift to straight up, before the way home [m]."""
TOY_IN_TCP = (-0.015, 0.005)
"""Where the toy's centre is to be along the TCP's x and y [m]: from there a closing hand does not push it about."""
TURN_SPEED = 1.0
"""Speed of the target's rotation [rad/s]: what hangs in the hand is soft."""
ARRIVED = (0.006, 0.05)
"""The TCP counts as arrived this close to its target [m, rad]; the open hand is 4 cm wider than the toy."""
CLOSING_TIME = 0.6
"""Wait for the fingers to close [s]: they are given their targets at once and meet the toy after 0.2 s."""
HELD = 0.10
"""The toy is in the hand while its centre is this close to the TCP [m]."""
TURNS = tuple(np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0]))
"""Angles between the fingers and the direction away from the base that are tried, in the order of preference [rad]."""
ATTEMPTS = 2
"""How often to try."""


class Phase(Enum):
    """What the expert is doing."""

    APPROACH = "approach"
    DESCEND = "descend"
    SETTLE = "settle"
    CLOSE = "close"
    LIFT = "lift"
    HOME = "home"
    RETREAT = "retreat"
    GIVEN_UP = "given up"


class ToyExpert(Agent):
    """Picks the toy whose pose is in `info["toy"]`, by the same actions that a policy would send."""

    def __init__(self, setup: Setup, action_space: spaces.Dict, kinematics: DampedLeastSquares) -> None:
        """Act in an environment.

        Args:
            setup: The environment's setup.
            action_space: The environment's action space.
            kinematics: Of the arm with its hand.
        """
        self._period = 1.0 / setup.frequency
        # A synchronous step ends at its target: there, bigger steps only mean fewer of them.
        self._pace = 1.0 if setup.mode != "sync" else 3.0
        self._kinematics = kinematics
        self._writer = ActionWriter(setup, action_space, kinematics)
        self._failure: str | None = None
        self._phase = Phase.APPROACH
        self._home = np.zeros(7)
        self._grasp = np.zeros(7)
        self._target = np.zeros(7)
        self._opening = 1.0
        self._steps = 0
        self._attempts = 0

    @property
    def failure(self) -> str | None:
        """`ik`: no grasp is feasible; `no_contact`: the hand closed on nothing; `slip`: it lost the toy."""
        return self._failure

    @property
    def phase(self) -> Phase:
        """What the expert is doing."""
        return self._phase

    @property
    def home(self) -> NDArray[np.float64]:
        """TCP pose that the toy is brought to, in the base frame, (7,): where the arm was at the start."""
        return self._home.copy()

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan the grasp of a new episode.

        Raises:
            WrongOrder: The info has no toy: this is not Pick-Toy.
        """
        if "toy" not in info:
            raise WrongOrder("ToyExpert needs info['toy'], the pose of the toy; use it in the task PickToy.")
        self._writer.reset(observation)
        self._failure = None
        self._attempts = 0
        self._home = np.array(observation[TQUAT])
        self._target = self._home.copy()
        self._begin_attempt(observation, info)

    def _begin_attempt(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self._attempts += 1
        self._opening = 1.0
        grasp = plan_palm_down(np.asarray(info["toy"])[:3], np.array(observation[JOINTS]), self._kinematics)
        if grasp is None:
            self._failure = "ik"
            self._enter(Phase.GIVEN_UP)
        else:
            self._grasp = grasp
            self._enter(Phase.APPROACH)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Go on with the present phase, or with the next when it is done."""
        self._steps += 1
        self._writer.follow(info)
        self._advance(observation, info)
        goal, speed = self._goal()
        step, turn = self._pace * speed * self._period, self._pace * TURN_SPEED * self._period
        self._target = limit_step(self._target, goal, step, turn)
        action = self._writer.write(self._target, self._opening)
        if action is None:
            self._failure = self._failure or "ik"
            action = self._writer.write_joints(self._writer.joints, self._opening)
        return action

    def _goal(self) -> tuple[NDArray[np.float64], float]:
        if self._phase is Phase.GIVEN_UP:
            return self._target, 0.0
        if self._phase is Phase.HOME:
            return self._home, LIFT_SPEED
        goal = self._grasp.copy()
        if self._phase in (Phase.APPROACH, Phase.RETREAT):
            goal[2] += CLEARANCE
            return goal, APPROACH_SPEED
        if self._phase is Phase.LIFT:
            goal[2] += LIFT
            return goal, LIFT_SPEED
        return goal, DESCENT_SPEED

    def _advance(self, observation: Observation, info: Mapping[str, Any]) -> None:
        elapsed = self._steps * self._period
        is_done = elapsed > PATIENCE or self._has_arrived(observation)
        if self._phase is Phase.APPROACH and is_done:
            self._enter(Phase.DESCEND)
        elif self._phase is Phase.DESCEND and is_done:
            self._enter(Phase.SETTLE)
        elif self._phase is Phase.SETTLE and elapsed >= SETTLE_TIME:
            self._opening = 0.0
            self._enter(Phase.CLOSE)
        elif self._phase is Phase.CLOSE and elapsed >= CLOSING_TIME:
            if not info["is_touched"]:
                self._give_up("no_contact")
            else:
                self._enter(Phase.LIFT)
        elif self._phase is Phase.LIFT and is_done:
            self._enter(Phase.HOME)
        elif self._phase is Phase.RETREAT and is_done:
            self._begin_attempt(observation, info)
        if self._phase in (Phase.LIFT, Phase.HOME):
            offset = np.asarray(info["toy"])[:3] - observation[TQUAT][:3]
            if float(np.sqrt(offset @ offset)) > HELD:
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


def plan_palm_down(
    toy: NDArray[np.float64], start: NDArray[np.float64], kinematics: DampedLeastSquares
) -> NDArray[np.float64] | None:
    """Plan a grasp from above whose fingers point away from the base as directly as can be.

    Args:
        toy: Centre of the toy in the base frame [m], shape (3,).
        start: Joints to start from [rad], shape (dof,).
        kinematics: Of the arm with its hand.

    Returns:
        TCP pose of the grasp in the base frame, (7,); None when nothing is feasible.
    """
    options = freedom_of(kinematics)
    azimuth = float(np.arctan2(toy[1], toy[0]))
    for turn in TURNS:
        # A half turn about x points the palm down, then the yaw; the toy is a little off the TCP.
        at_toy = Pose((float(toy[0]), float(toy[1]), float(toy[2])))
        palm_down = at_toy * Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, azimuth + turn))
        grasp = palm_down * Pose((-TOY_IN_TCP[0], -TOY_IN_TCP[1], 0.0))
        above = kinematics.inverse(Pose((0.0, 0.0, CLEARANCE)) * grasp, start, options.first)
        down = kinematics.inverse(grasp, above.joints, options.options)
        if above.status == IkStatus.ok and down.status == IkStatus.ok:
            return grasp.tquat
    return None
