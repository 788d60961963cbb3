"""Executes recorded episodes again, if wanted in another control mode, and measures where that leads elsewhere."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.agents import Agent, Replay
from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Action
from rcs.data import Dataset, DatasetWriter, EpisodeRecord
from rcs.envs import spaces as keys
from rcs.envs.assemble import compose
from rcs.envs.env import Env
from rcs.envs.observers.recorder import ACTION, EXECUTED, OBSERVATION, Recorder
from rcs.envs.setup import Relative, Setup
from rcs.envs.spaces import Control, Observation
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.rollout.derive import SOURCE, derive, source_of
from rcs.rollout.divergence import Divergence, Tolerance, Trace
from rcs.rollout.look import Look, Stage, physics_of, require_rate, require_states, setup_of, varied
from rcs.rollout.replay import recorded
from rcs.setups.make import resolve
from rcs.sim.scene import RobotPlacement
from rcs.sim.state_transfer import StateTransfer

MODE = "actions"


@dataclass(frozen=True, kw_only=True)
class Reexecution:
    """What to execute again."""

    source: Path
    """Folder of the dataset."""
    out: Path
    """Folder of the new one."""
    control: Control | None = None
    """What actions shall say of the arm; None for what they say in the dataset."""
    relative: Relative | None = None
    """What they shall be added to; None for nothing if `control` is given, and otherwise for as in the dataset."""
    look: Look = field(default_factory=Look)
    tolerance: Tolerance = field(default_factory=Tolerance)
    grace: float = 1.0
    """For how long the last target is held when the actions are over and the task is not done yet [s]."""
    workers: int = 1
    """Processes; 0 for one per core."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A time that makes no sense.
        """
        if not 0 <= self.grace < np.inf:
            raise InvalidSetup(f"grace is {self.grace} s; valid is 0 and more.")

    @property
    def is_translated(self) -> bool:
        """Whether actions are written anew instead of taken as they are."""
        return self.control is not None or self.relative is not None

    def setup(self, before: Setup) -> Setup:
        """Return the setup to execute in."""
        relative = self.relative or ("absolute" if self.control is not None else before.relative)
        return replace(before, control=self.control or before.control, relative=relative)


@dataclass(frozen=True, kw_only=True)
class ReexecutionResult:
    """One episode that was executed again."""

    episode_id: str
    steps: int
    recorded_steps: int
    success: bool
    recorded_success: bool | None
    divergence: Divergence
    first_beyond: tuple[int, str] | None
    """First row with an error beyond the tolerance, and which; None if there is none."""

    def to_json(self, *, with_rows: bool = False) -> dict[str, Any]:
        """Return the result as JSON values.

        Args:
            with_rows: With the errors of every row, not only the largest and the median.
        """
        first = self.first_beyond
        values: dict[str, Any] = {
            "episode": self.episode_id,
            "steps": self.steps,
            "recorded_steps": self.recorded_steps,
            "success": self.success,
            "recorded_success": self.recorded_success,
            "errors": self.divergence.summary(),
            "first_beyond_tolerance": None if first is None else {"row": first[0], "error": first[1]},
        }
        return {**values, "rows": self.divergence.to_json()} if with_rows else values


def reexecute(execution: Reexecution) -> Iterator[ReexecutionResult]:
    """Execute the actions of every episode from its first state, and record what comes of it.

    In another control mode, each step's action is written for the joint targets that were sent to the devices: the
    targets themselves, or the TCP's poses there.

    Raises:
        InvalidSetup: The dataset is not from simulation, or an option makes no sense.
        DatasetError, CorruptEpisode: A dataset cannot be read or written.
    """
    dataset = Dataset.open(execution.source)
    require_states(dataset)
    require_rate(dataset)
    stage = _stage(execution, dataset)
    env, _ = stage.env()
    try:
        info = stage.info(env, dataset.info)
    finally:
        env.close()
    make = functools.partial(_Reexecutor, execution)
    return derive(execution.out, info, make, range(len(dataset)), execution.workers)


def _stage(execution: Reexecution, dataset: Dataset) -> Stage:
    return Stage.of(physics_of(dataset), execution.setup(setup_of(dataset)), execution.look)


class _Reexecutor:
    """Executes episodes again: the part that one process does."""

    def __init__(self, execution: Reexecution, out: Path) -> None:
        self._execution = execution
        self._dataset = Dataset.open(execution.source)
        stage = _stage(execution, self._dataset)
        self._setup = stage.setup
        self._writer = DatasetWriter.join(out)
        self._env, self._looks = stage.env()
        self._recorder = Recorder(self._writer)
        self._env.add_observer(self._recorder)
        source = compose(resolve(replace(physics_of(self._dataset), assets="builtin"))).compile()
        self._transfer = StateTransfer(source, self._env.scenario.world.model)

    def attempt(self, number: int) -> ReexecutionResult:
        """Execute one episode again."""
        episode = self._dataset.episodes[number]
        states = self._transfer(episode.sim_state())
        agent = self._agent(episode)
        if self._looks is not None:
            self._looks.episode_id = episode.id
        self._recorder.name_next(episode.id, instruction=episode.instruction)
        with self._recorder.discard_on_error():
            return self._execute(episode, states, agent)

    def _execute(self, episode: EpisodeRecord, states: np.ndarray[Any, Any], agent: Agent) -> ReexecutionResult:
        """Make the steps, and keep what came of them."""
        observation, info = self._env.reset(seed=episode.seed, options={"state": states[0]})
        agent.reset(observation, info)
        rows = [_look_at(observation, self._env)]
        steps = len(states) - 1
        most = steps + (round(self._execution.grace * self._setup.frequency) if self._execution.is_translated else 0)
        is_over, reward = False, 0.0
        while not is_over and len(rows) <= most:
            observation, earned, terminated, truncated, info = self._env.step(agent.act(observation, info))
            rows.append(_look_at(observation, self._env))
            reward += float(earned)
            is_over = terminated or truncated
        success = bool(info.get("success", False))
        divergence = Divergence.between(self._recorded(episode, states), _trace(rows))
        result = ReexecutionResult(
            episode_id=episode.id,
            steps=len(rows) - 1,
            recorded_steps=steps,
            success=success,
            recorded_success=episode.success,
            divergence=divergence,
            first_beyond=divergence.first_beyond(self._execution.tolerance),
        )
        told = result.to_json()
        kept = {key: told[key] for key in ("errors", "first_beyond_tolerance")}
        source = source_of(episode, self._dataset.path, MODE)
        failure = None if success else "replay"
        outcome = {"failure": failure, "reward": reward, **varied(self._env), SOURCE: {**source, **kept}}
        self._recorder.finish(success, outcome)
        return result

    def _agent(self, episode: EpisodeRecord) -> Agent:
        space = self._env.stack.action_space
        if not self._execution.is_translated:
            return Replay(recorded(episode, ACTION, space))
        robots = [robot.placement for robot in self._env.scenario.robots]
        return Translator(self._setup, space, robots, episode)

    def _recorded(self, episode: EpisodeRecord, states: np.ndarray[Any, Any]) -> Trace:
        """Return what the recorded episode did; where objects were comes from its states, restored."""
        world, scenario = self._env.scenario.world, self._env.scenario
        objects: list[np.ndarray[Any, Any]] = []
        for state in states:
            world.core.set_state(state)
            world.refresh()
            objects.append(_objects(self._env))
        prefixes = _prefixes([robot.placement for robot in scenario.robots])
        return Trace(
            joints=np.hstack([episode.column(f"{OBSERVATION}/{prefix}{keys.JOINTS}") for prefix in prefixes]),
            tcps=np.stack([episode.column(f"{OBSERVATION}/{prefix}{keys.TQUAT}") for prefix in prefixes], axis=1),
            objects=np.stack(objects),
        )

    def close(self) -> None:
        """Close the environment and the writer."""
        self._env.close()
        self._writer.close()


class Translator(Agent):
    """Writes the targets of a recorded episode in the control mode of an environment; holds the last one in the end."""

    def __init__(self, setup: Setup, space: spaces.Dict, robots: list[RobotPlacement], episode: EpisodeRecord) -> None:
        """Read the targets.

        Args:
            setup: Of the environment.
            space: Its action space.
            robots: Its robots.
            episode: The recorded episode.

        Raises:
            InvalidSetup: The dataset has no joint targets of these robots.
        """
        self._is_single = len(robots) == 1
        self._writers: dict[str, ActionWriter] = {}
        self._targets: dict[str, np.ndarray[Any, Any]] = {}
        self._others: dict[str, dict[str, np.ndarray[Any, Any]]] = {}
        for robot, prefix in zip(robots, _prefixes(robots), strict=True):
            inner = space if self._is_single else space[robot.name]
            assert isinstance(inner, spaces.Dict)
            self._writers[robot.name] = ActionWriter(setup, inner, kinematics_of(robot.arm, robot.end_effector))
            self._targets[robot.name] = episode.column(f"{EXECUTED}/{prefix}{keys.JOINTS}")[1:]
            others = [key for key in inner.spaces if key != setup.control]
            self._others[robot.name] = {key: episode.column(f"{ACTION}/{prefix}{key}")[1:] for key in others}
        self._control = setup.control
        self._next = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Start at the first target."""
        self._next = 0
        for name, writer in self._writers.items():
            writer.reset(observation if self._is_single else observation[name])

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action of the next recorded target."""
        action: Action = {}
        for name, targets in self._targets.items():
            i = min(self._next, len(targets) - 1)
            self._writers[name].follow(info, None if self._is_single else name)
            written = self._writers[name].write_joints(targets[i], 0.0)
            others = {key: values[i] for key, values in self._others[name].items()}
            action[name] = {self._control: written[self._control], **others}
        self._next += 1
        return action[next(iter(action))] if self._is_single else action


def _prefixes(robots: list[RobotPlacement]) -> list[str]:
    """Return what stands before the keys of each robot."""
    return [""] if len(robots) == 1 else [f"{robot.name}/" for robot in robots]


def _objects(env: Env) -> np.ndarray[Any, Any]:
    """Return the poses of all objects, (objects, 7)."""
    return np.array(list(env.scenario.object_poses().values())).reshape(-1, 7)


def _look_at(observation: Observation, env: Env) -> tuple[Any, Any, Any]:
    robots = env.scenario.robots
    parts = [observation] if len(robots) == 1 else [observation[robot.placement.name] for robot in robots]
    joints = np.concatenate([part[keys.JOINTS] for part in parts])
    return joints, np.stack([part[keys.TQUAT] for part in parts]), _objects(env)


def _trace(rows: list[tuple[Any, Any, Any]]) -> Trace:
    joints, tcps, objects = (np.stack(part) for part in zip(*rows, strict=True))
    return Trace(joints=joints, tcps=tcps, objects=objects)
