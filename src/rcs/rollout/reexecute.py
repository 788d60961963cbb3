"""Executes recorded episodes again, in another control mode if given, and measures the divergence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data import Dataset, EpisodeRecord

from rcs.agents import Agent, Replay
from rcs.agents.action_writer import ActionWriter
from rcs.envs import spaces as keys
from rcs.envs.by_robot import by_robot, joined, prefixes
from rcs.envs.env import Env
from rcs.envs.observers.recorder import ACTION, EXECUTED
from rcs.envs.setup import RelativeTo, Setup
from rcs.envs.spaces import Action, Control, Observation
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.rollout.derive import Derivation, Workplace
from rcs.rollout.divergence import Divergence, Tolerance, Trace
from rcs.rollout.look import Stage, physics_of, require_rate, require_states, setup_of
from rcs.rollout.replay import recorded


@dataclass(frozen=True, kw_only=True)
class ReexecutionResult:
    """The result of one episode executed again."""

    episode_id: str
    steps: int
    recorded_steps: int
    success: bool
    recorded_success: bool | None
    divergence: Divergence
    first_beyond: tuple[int, str] | None
    """First row beyond the tolerance and the name of its error; None if there is none."""

    def kept(self) -> dict[str, Any]:
        """Return the entries for the outcome, as JSON values."""
        first = self.first_beyond
        beyond = None if first is None else {"row": first[0], "error": first[1]}
        return {"errors": self.divergence.summary(), "first_beyond_tolerance": beyond}

    def to_json(self, *, with_rows: bool = False) -> dict[str, Any]:
        """Return the result as JSON values.

        Args:
            with_rows: Whether to include the errors of every row.
        """
        values: dict[str, Any] = {
            "episode": self.episode_id,
            "steps": self.steps,
            "recorded_steps": self.recorded_steps,
            "success": self.success,
            "recorded_success": self.recorded_success,
            **self.kept(),
        }
        return {**values, "rows": self.divergence.to_json()} if with_rows else values


@dataclass(frozen=True, kw_only=True)
class Reexecution(Derivation):
    """Executes the actions of every episode from its first state, and records the result.

    In another control mode, actions are computed from the joint targets that were sent to the devices: the targets
    themselves, or the TCP poses at them, or the twists that lead there.
    """

    kind = "actions"

    control: Control | None = None
    """Control mode of the new actions; None for the recorded one."""
    relative: RelativeTo | None = None
    """Reference of relative actions; None for absolute ones if `control` is given and not a twist, which has no other
    than the last step, else for the recorded one."""
    tolerance: Tolerance = field(default_factory=Tolerance)
    grace: float = 1.0
    """How long to hold the last target if the task is not done yet [s]."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A time is not valid.
        """
        if not 0 <= self.grace < np.inf:
            raise InvalidSetup(f"grace is {self.grace} s; valid is 0 and more.")

    @property
    def is_translated(self) -> bool:
        """Whether actions are computed instead of copied."""
        return self.control is not None or self.relative is not None

    def stage(self, dataset: Dataset) -> Stage:
        """Return the recorded scene, with the new control mode."""
        require_states(dataset)
        physics, before = physics_of(dataset, trust=self.trust), setup_of(dataset, trust=self.trust)
        require_rate(dataset, physics)
        otherwise = "last_step" if self.control == keys.TWIST else "absolute"
        relative = self.relative or (otherwise if self.control is not None else before.relative)
        setup = replace(before, control=self.control or before.control, relative=relative)
        return Stage.of(physics, setup, self.look)

    def make(self, workplace: Workplace, episode: EpisodeRecord) -> ReexecutionResult:
        """Execute one episode again."""
        env, setup = workplace.env, workplace.stage.setup
        states = workplace.transfer(episode.sim_state())
        before = Trace.of([*_restored(env, states)])
        space = env.stack.action_space
        agent = Translator(env, setup, episode) if self.is_translated else Replay(recorded(episode, ACTION, space))
        steps = len(states) - 1
        most = steps + (round(self.grace * setup.frequency) if self.is_translated else 0)
        rows: list[Trace] = []
        start = {"state": states[0]}
        last = workplace.play(episode, agent, start, most, lambda step: rows.append(_trace(env)))
        divergence = Divergence.between(before, Trace.of(rows))
        result = ReexecutionResult(
            episode_id=episode.id,
            steps=last.row,
            recorded_steps=steps,
            success=last.success,
            recorded_success=episode.success,
            divergence=divergence,
            first_beyond=divergence.first_beyond(self.tolerance),
        )
        workplace.keep(episode, last, result.kept())
        return result


class Translator(Agent):
    """Writes the targets of a recorded episode in an environment's control mode, and holds the last one at the end."""

    def __init__(self, env: Env, setup: Setup, episode: EpisodeRecord) -> None:
        """Read the targets.

        Args:
            env: The environment.
            setup: Its setup.
            episode: The recorded episode.

        Raises:
            InvalidSetup: The dataset has no joint targets of these robots.
        """
        robots = {robot.placement.name: robot.placement for robot in env.scenario.robots}
        self._writers: dict[str, ActionWriter] = {}
        self._targets: dict[str, NDArray[Any]] = {}
        self._others: dict[str, dict[str, NDArray[Any]]] = {}
        spaces = by_robot(robots, env.stack.action_space)
        for name, prefix in prefixes(robots).items():
            kinematics = kinematics_of(robots[name].arm, robots[name].end_effector)
            self._writers[name] = ActionWriter(setup, spaces[name], kinematics)
            self._targets[name] = episode.column(f"{EXECUTED}/{prefix}{keys.JOINTS}")[1:]
            others = [key for key in spaces[name].spaces if key != setup.control]
            self._others[name] = {key: episode.column(f"{ACTION}/{prefix}{key}")[1:] for key in others}
        self._control = setup.control
        self._next = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Start at the first target."""
        self._next = 0
        for name, part in by_robot(self._writers, observation).items():
            self._writers[name].reset(part)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action of the next recorded target."""
        action: dict[str, Action] = {}
        for name, targets in self._targets.items():
            i = min(self._next, len(targets) - 1)
            self._writers[name].follow(info, None if len(self._targets) == 1 else name)
            written = self._writers[name].write_joints(targets[i], 0.0)
            others = {key: values[i] for key, values in self._others[name].items()}
            action[name] = {self._control: written[self._control], **others}
        self._next += 1
        return joined(action)


def _trace(env: Env) -> Trace:
    """Return the present row of an environment's trace."""
    robots = env.scenario.robots
    return Trace(
        joints=np.concatenate([robot.joints for robot in robots]),
        tcps=np.stack([robot.tcp_tquat for robot in robots]),
        objects=np.array(list(env.scenario.object_poses().values())).reshape(-1, 7),
    )


def _restored(env: Env, states: NDArray[np.float64]) -> Iterator[Trace]:
    """Give what the recorded episode did, row by row: its states are restored for that."""
    world = env.scenario.world
    for state in states:
        world.core.set_state(state)
        world.refresh()
        yield _trace(env)
