"""A scripted expert for Lift-Bar: two arms that grasp, lift and hold in step with each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Action, Agent
from rcs.agents.grasp import plan_top_grasp
from rcs.agents.pick_expert import (
    APPROACH_SPEED,
    ARRIVED,
    CLEARANCE,
    CLOSING_TIME,
    DESCENT_SPEED,
    EMPTY,
    PATIENCE,
    SETTLE_TIME,
    STILL,
    TURN_SPEED,
)
from rcs.envs.setup import Setup
from rcs.envs.spaces import GRIPPER, JOINTS, TQUAT, Observation
from rcs.errors import WrongOrder
from rcs.kinematics import DampedLeastSquares
from rcs.spatial import Pose, distance, limit_step

LIFT = 0.15
"""Height to lift to above the grasp [m]: the task wants 0.10."""
LIFT_SPEED = 0.15
"""Speed of lifting [m/s]; slow, so that both ends stay level."""


class Phase(Enum):
    """What both arms are doing."""

    APPROACH = "approach"
    DESCEND = "descend"
    SETTLE = "settle"
    CLOSE = "close"
    LIFT = "lift"
    GIVEN_UP = "given up"


@dataclass
class _Side:
    """What the expert keeps of one arm."""

    name: str
    base_in_scene: Pose
    kinematics: DampedLeastSquares
    writer: ActionWriter
    end: float
    """Which end it grasps: +1 for the one along the bar's y, -1 for the other."""
    grasp: NDArray[np.float64] = field(default_factory=lambda: np.zeros(7))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(7))
    last_opening: float = 1.0
    is_still: bool = False


class LiftExpert(Agent):
    """Lifts a bar with both arms of an environment.

    Its pose is in `info["bar_in_scene"]`; it is grasped `info["grasp_offset"]` from its middle.
    """

    def __init__(
        self,
        setup: Setup,
        action_space: spaces.Dict,
        bases_in_scene: Mapping[str, Pose],
        kinematics: Mapping[str, DampedLeastSquares],
    ) -> None:
        """Act in an environment.

        Args:
            setup: The environment's setup.
            action_space: The environment's action space, a dictionary per robot.
            bases_in_scene: Base frame of each robot in the scene; the first is on the bar's side of positive y.
            kinematics: Of each arm with its gripper.
        """
        self._period = 1.0 / setup.frequency
        self._sides: list[_Side] = []
        for (name, base), end in zip(bases_in_scene.items(), (1.0, -1.0), strict=True):
            space = action_space[name]
            assert isinstance(space, spaces.Dict)
            writer = ActionWriter(setup, space, kinematics[name])
            self._sides.append(_Side(name, base, kinematics[name], writer, end))
        self._phase = Phase.APPROACH
        self._steps = 0
        self._opening = 1.0
        self._failure: str | None = None

    @property
    def failure(self) -> str | None:
        """`ik`: a grasp is not feasible; `no_contact`: a gripper closed on nothing; `slip`: one lost the bar."""
        return self._failure

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan both grasps.

        Raises:
            WrongOrder: The info has no bar: this is not Lift-Bar.
        """
        if not {"bar_in_scene", "grasp_offset"} <= info.keys():
            raise WrongOrder(
                "LiftExpert needs info['bar_in_scene'] and info['grasp_offset']; use it in the task LiftBar."
            )
        bar, offset = Pose.from_tquat(info["bar_in_scene"]), float(info["grasp_offset"])
        self._failure = None
        self._opening = 1.0
        self._enter(Phase.APPROACH)
        for side in self._sides:
            own = observation[side.name]
            side.writer.reset(own)
            side.target = np.array(own[TQUAT])
            end = side.base_in_scene.inverse() * (bar * Pose((0.0, side.end * offset, 0.0)))
            # Across the bar: its short side is along its x axis.
            plan = plan_top_grasp(end, end.matrix[:3, 0], np.array(own[JOINTS]), side.kinematics, CLEARANCE, LIFT)
            if plan is None:
                self._failure = "ik"
                self._enter(Phase.GIVEN_UP)
            else:
                side.grasp = plan.tcp

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Go on with the present phase, or with the next when both arms are done."""
        self._steps += 1
        self._advance(observation)
        action: dict[str, Any] = {}
        for side in self._sides:
            side.writer.follow(info, side.name)
            goal, speed = self._goal(side)
            side.target = limit_step(side.target, goal, speed * self._period, TURN_SPEED * self._period)
            own = side.writer.write(side.target, self._opening)
            if own is None:
                self._failure = self._failure or "ik"
                own = side.writer.write(np.array(observation[side.name][TQUAT]), self._opening)
                assert own is not None, "the present pose is always feasible"
            action[side.name] = own
        return action

    def _goal(self, side: _Side) -> tuple[NDArray[np.float64], float]:
        if self._phase is Phase.GIVEN_UP:
            return side.target, 0.0
        goal = side.grasp.copy()
        if self._phase is Phase.APPROACH:
            goal[2] += CLEARANCE
            return goal, APPROACH_SPEED
        if self._phase is Phase.LIFT:
            goal[2] += LIFT
            return goal, LIFT_SPEED
        return goal, DESCENT_SPEED

    def _advance(self, observation: Observation) -> None:
        elapsed = self._steps * self._period
        openings = [float(observation[side.name][GRIPPER][0]) for side in self._sides]
        still = [abs(opening - side.last_opening) < STILL for opening, side in zip(openings, self._sides, strict=True)]
        for side, opening in zip(self._sides, openings, strict=True):
            side.last_opening = opening
        is_late = elapsed > PATIENCE
        if self._phase is Phase.APPROACH and (self._have_arrived(observation) or is_late):
            self._enter(Phase.DESCEND)
        elif self._phase is Phase.DESCEND and (self._have_arrived(observation) or is_late):
            self._enter(Phase.SETTLE)
        elif self._phase is Phase.SETTLE and elapsed >= SETTLE_TIME:
            self._opening = 0.0
            self._enter(Phase.CLOSE)
        elif self._phase is Phase.CLOSE and ((elapsed > CLOSING_TIME and all(still)) or is_late):
            if min(openings) < EMPTY:
                self._give_up("no_contact")
            else:
                self._enter(Phase.LIFT)
        if self._phase is Phase.LIFT and min(openings) < EMPTY:
            self._give_up("slip")

    def _give_up(self, why: str) -> None:
        self._failure = why
        self._opening = 1.0
        self._enter(Phase.GIVEN_UP)

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._steps = 0

    def _have_arrived(self, observation: Observation) -> bool:
        for side in self._sides:
            goal, _ = self._goal(side)
            translation, rotation = distance(np.array(observation[side.name][TQUAT]), goal)
            if translation > ARRIVED[0] or rotation > ARRIVED[1]:
                return False
        return True
