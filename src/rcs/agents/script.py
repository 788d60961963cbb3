"""Scripted behaviours: phases that all arms of an environment go through in step, with the actions of a policy."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, JOINTS, TQUAT, Action, Observation
from rcs.errors import WrongOrder
from rcs.kinematics import Kinematics, kinematics_of
from rcs.sim.scene import RobotPlacement
from rcs.spatial import distance, limit_step

PATIENCE = 4.0
"""Longest time that a phase waits at its goal, such as for arms to arrive; then the script goes on regardless [s]."""

BRAKING = 1.0
"""Deceleration of a streamed target before its goal [m/s^2]: an arm overshoots a stream that ends abruptly."""

STILL = 0.005
"""Speed of the TCP below which an arm stands still [m/s]."""
SAME_READING = 1e-3
"""Time between two readings of a gripper that are one and the same, whose age is measured twice [s]."""

Condition = Callable[["Script"], bool]
Plan = Mapping[str, NDArray[np.float64]]
"""Poses of one arm: TCP poses in the base frame, (7,), by the names used in phases."""


@dataclass(frozen=True)
class Phase:
    """A part of a script. It ends `PATIENCE` after its targets are at the goal; the last one of a script never ends."""

    name: str
    goal: str = ""
    """Name of the pose to which every arm moves in a straight line; empty to stay."""
    speed: float = 0.20
    """Speed of the TCP's target [m/s]."""
    opening: float = 1.0
    """Opening of the grippers, 0 closed … 1 open."""
    until: Condition = lambda script: script.has_arrived()
    risk: tuple[str, Condition] | None = None
    """Class of a failure that ends the attempt, and the test for it."""
    is_judged_at_end: bool = False
    """Check for the failure only when the phase is done."""
    turn_speed: float = np.inf
    """Rotational speed of the target, if less than that of the script [rad/s]."""


GIVEN_UP = Phase("given up")


class ScriptedArm:
    """One arm of a script: its solver, its latest two observations and readings of the gripper, and its plan."""

    def __init__(self, env: Env, key: str | None, robot: RobotPlacement) -> None:
        self.key, self.robot = key, robot
        self.kinematics: Kinematics = kinematics_of(robot.arm, robot.end_effector)
        space: Any = env.action_space
        self.writer = ActionWriter(
            env.setup, space if key is None else space[key], self.kinematics, preferred=robot.arm.home
        )
        self.observation: Observation = {}
        self.before: Observation = {}
        self.openings: deque[tuple[float, float]] = deque(maxlen=2)
        """Times [s] and openings of the latest two readings of the gripper, oldest first."""
        self.start = np.zeros(0)
        """Joints at the start of the episode [rad]."""
        self.target = np.zeros(0)
        """The last TCP target in the base frame, (7,)."""
        self.plan: Plan = {}

    def see(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Take the observation of a new step, and the executed target of the last action."""
        own = observation if self.key is None else observation[self.key]
        self.before, self.observation = self.observation or own, own
        if GRIPPER in own:
            # A hand sends few states, and one that is seen twice does not show that the fingers stand still.
            age = info.get("ages", {}).get(GRIPPER if self.key is None else f"{self.key}/{GRIPPER}", 0.0)
            at = float(info["time"]) - age
            if not self.openings or at > self.openings[-1][0] + SAME_READING:
                self.openings.append((at, float(own[GRIPPER][0])))
        self.writer.follow(info, self.key)


class Script(Agent):
    """Goes through phases, and retries from the first pose after a failure. A subclass declares phases and a plan."""

    task: ClassVar[str]
    needs: ClassVar[tuple[str, ...]]
    """Keys required in the task's info."""
    phases: ClassVar[Sequence[Phase]]
    attempts: ClassVar[int] = 2
    infeasible: ClassVar[str] = "ik"
    """Class of the failure if there is no plan."""
    turn_speed: ClassVar[float] = 2.0
    """Rotational speed of the target [rad/s]."""
    arrived: ClassVar[tuple[float, float]] = (0.004, 0.03)
    """Distance of the TCP from its goal at which an arm has arrived [m, rad]."""

    def __init__(self, env: Env) -> None:
        self._period = 1.0 / env.setup.frequency
        self._ends_at_rest = env.setup.stepping == "sync"
        # A synchronous step ends at its target, so bigger steps only mean fewer of them.
        self._pace = self._period * (3.0 if self._ends_at_rest else 1.0)
        is_single = len(env.robots) == 1
        self.arms = [ScriptedArm(env, None if is_single else name, robot) for name, robot in env.robots.items()]
        self._retreat = replace(self.phases[0], name="retreat")
        self._phase, self._attempt = GIVEN_UP, 0
        self._began = self._reached = self._now = 0.0
        self._failure: str | None = None
        self.info: Mapping[str, Any] = {}
        self.elapsed = 0.0
        """Time since the present phase began, by the clock of the environment [s]."""
        self.step_time = self._period
        """How long the last step took, by the same clock [s]."""

    @abstractmethod
    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Return the poses of an arm by the names used in phases (`home` is added); None if they are not feasible."""

    def prepare(self, phase: Phase) -> None:
        """Change the arms' plans when a phase begins, by what is known then."""

    @property
    def failure(self) -> str | None:
        """`ik`: a pose is not feasible; `no_contact`: a gripper closed on nothing; `slip`: it lost the object."""
        return self._failure

    @property
    def phase(self) -> str:
        """Name of the present phase; `retreat` between two attempts, and `given up` after the last one."""
        return self._phase.name

    def is_over(self, holding: float) -> bool:
        """Return whether nothing more will happen: it has given up, or was at its last goal for some seconds."""
        is_last = self._phase is self.phases[-1] and self._now - self._reached >= holding
        return is_last or self._phase is GIVEN_UP

    def has_arrived(self) -> bool:
        """Return whether all arms are at the goal of the present phase."""
        pairs = [(arm.observation[TQUAT], self._place(arm)) for arm in self.arms]
        return all(bool((distance(tcp, place) < self.arrived).all()) for tcp, place in pairs)

    def is_still(self) -> bool:
        """Return whether the TCPs of all arms move slower than `STILL`."""
        moves = [arm.observation[TQUAT][:3] - arm.before[TQUAT][:3] for arm in self.arms]
        return all(float(np.sqrt(move @ move)) <= STILL * self.step_time for move in moves)

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan a new episode.

        Raises:
            WrongOrder: The info lacks a required key: the environment has another task.
        """
        if missing := [key for key in self.needs if key not in info]:
            raise WrongOrder(f"{type(self).__name__} needs info[{missing[0]!r}]; use it in the task {self.task}.")
        self.info, self._failure, self._attempt, self._now = info, None, 0, float(info["time"])
        for arm in self.arms:
            arm.openings.clear()
            arm.see(observation, info)
            arm.writer.reset(arm.observation)
            arm.start, arm.target = np.array(arm.observation[JOINTS]), np.array(arm.observation[TQUAT])
        self._begin()

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Continue the present phase, or start the next if all arms are done."""
        self.info = info
        for arm in self.arms:
            arm.see(observation, info)
        now = float(info["time"])
        self.step_time, self._now = max(now - self._now, 1e-9), now
        self.elapsed = now - self._began
        self._advance()
        actions = {arm.robot.name: self._step(arm) for arm in self.arms}
        return actions if len(actions) > 1 else actions[self.arms[0].robot.name]

    def _begin(self) -> None:
        self._attempt += 1
        plans = [self.plan(arm) for arm in self.arms]
        for arm, plan in zip(self.arms, plans, strict=True):
            arm.plan = {"home": arm.kinematics.forward(np.array(arm.robot.arm.home)).tquat, **(plan or {})}
        if None in plans:
            self._failure = self.infeasible
        self._enter(GIVEN_UP if None in plans else self.phases[0])

    def _advance(self) -> None:
        phase = self._phase
        if not all(np.array_equal(arm.target, self._place(arm)) for arm in self.arms):
            self._reached = self._now
        is_done = self._now - self._reached > PATIENCE or phase.until(self)
        if phase.risk is not None and (is_done or not phase.is_judged_at_end) and phase.risk[1](self):
            self._failure = phase.risk[0]
            self._enter(self._retreat if self._attempt < self.attempts else GIVEN_UP)
        elif is_done and phase is self._retreat:
            self._begin()
        elif is_done and phase in self.phases[:-1]:
            self._enter(self.phases[self.phases.index(phase) + 1])

    def _enter(self, phase: Phase) -> None:
        self._phase, self._began, self._reached, self.elapsed = phase, self._now, self._now, 0.0
        self.prepare(phase)

    def _place(self, arm: ScriptedArm) -> NDArray[np.float64]:
        return arm.plan.get(self._phase.goal, arm.target)

    def _step(self, arm: ScriptedArm) -> Action:
        phase = self._phase
        turn_speed = min(phase.turn_speed, self.turn_speed)
        place = self._place(arm)
        speed = phase.speed
        if not self._ends_at_rest:
            way = float(distance(arm.target, place)[0])
            speed = min(speed, max(np.sqrt(2.0 * BRAKING * way), BRAKING * self._period))
        arm.target = limit_step(arm.target, place, speed * self._pace, turn_speed * self._pace)
        action = arm.writer.write(arm.target, phase.opening)
        if action is None:
            self._failure = self._failure or "ik"
            action = arm.writer.write_joints(arm.writer.joints, phase.opening)
        return action
