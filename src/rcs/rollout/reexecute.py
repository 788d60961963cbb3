"""Executes recorded actions again, judges the episodes, and measures how far they deviate from the recording."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data import Dataset, EpisodeRecord

from rcs.agents import Replay
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import ACTION
from rcs.rollout.derived_dataset import Derivation, EpisodeMaker, derive
from rcs.rollout.recorded_setup import physics_of, require_rate, require_states, setup_of
from rcs.rollout.replay import recorded
from rcs.rollout.replay_scene import Appearance, ReplayScene
from rcs.spatial import distance


@dataclass(frozen=True, kw_only=True)
class ReexecutionResult:
    """The result of an episode that was executed again, or that a simulated robot followed."""

    episode_id: str
    recorded_success: bool | None
    success: bool
    """The task's verdict on the new episode."""
    recorded_steps: int = 0
    steps: int = 0
    errors: Mapping[str, list[float]] = field(default_factory=dict[str, list[float]])
    """Deviations from the recording by row, see `deviation`; empty if the episode could not be made."""
    problem: str | None = None
    """Why the episode could not be made; None if it was."""

    def summary(self) -> dict[str, dict[str, float]]:
        """Return the largest and median deviation of each kind."""
        found = self.errors.items()
        return {name: {"max": max(rows), "median": float(np.median(rows))} for name, rows in found if rows}

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {
            "episode": self.episode_id,
            "steps": self.steps,
            "recorded_steps": self.recorded_steps,
            "success": self.success,
            "recorded_success": self.recorded_success,
            "problem": self.problem,
            "errors": self.summary(),
            "rows": dict(self.errors),
        }


@dataclass(frozen=True, kw_only=True)
class Poses:
    """The state of the robots and objects of an environment in one row."""

    joints: NDArray[np.float64]
    """Joints of all robots, (n,) [rad]."""
    tcps: NDArray[np.float64]
    """TCP poses of all robots, (robots, 7) [m], xyzw."""
    objects: NDArray[np.float64]
    """Poses of all objects, (objects, 7) [m], xyzw."""

    @staticmethod
    def of(env: Env) -> Poses:
        """Return the present state of an environment."""
        robots = env.simulation.robots
        return Poses(
            joints=np.concatenate([robot.joints for robot in robots]),
            tcps=np.stack([robot.tcp_tquat for robot in robots]),
            objects=np.array(list(env.simulation.object_poses().values())).reshape(-1, 7),
        )


def deviation(recorded: Poses, replayed: Poses) -> dict[str, float]:
    """Return the largest deviations of all joints, TCPs and objects.

    Returns:
        `joints` [rad], `position` [m] and `rotation` [rad] of the TCP, and `object_position` [m] and `object_rotation`
        [rad] if there are objects.
    """
    position, rotation = distance(recorded.tcps, replayed.tcps).max(axis=0)
    joints = np.abs(recorded.joints - replayed.joints).max()
    found = {"joints": float(joints), "position": float(position), "rotation": float(rotation)}
    if len(recorded.objects):
        position, rotation = distance(recorded.objects, replayed.objects).max(axis=0)
        found.update(object_position=float(position), object_rotation=float(rotation))
    return found


def reexecute(
    source: str | Path,
    out: str | Path,
    *,
    appearance: Appearance | None = None,
    workers: int = 1,
    trust: Collection[str] = (),
) -> Iterator[ReexecutionResult]:
    """Execute the actions of every simulated episode from its first state, and record the result in a new dataset.

    Args:
        source: Folder of the recorded dataset.
        out: Folder of the new dataset; it must not exist.
        appearance: Changes to the frames; None for the recorded ones.
        workers: Number of processes; 1 for this one, 0 for one per core.
        trust: Modules that may be imported because the dataset's setup names them.

    Raises:
        InvalidSetup: The dataset has no simulation states or was resampled, or an option is not valid.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    dataset = Dataset.open(source)
    require_states(dataset)
    physics, frames = physics_of(dataset, trust=trust), setup_of(dataset, trust=trust)
    require_rate(dataset, physics)
    scene = ReplayScene(physics=physics, frames=frames, appearance=appearance or Appearance())
    env, _ = scene.make()
    try:
        info = scene.info(env, dataset.info)
    finally:
        env.close()
    recipe = Derivation(kind="actions", source=Path(source), scene=scene, make=_execute)
    yield from derive(recipe, Path(out), info, workers)


def _execute(maker: EpisodeMaker, episode: EpisodeRecord) -> ReexecutionResult:
    env = maker.env
    states = maker.transfer(episode.sim_state())
    before = [*_restored(env, states)]
    agent = Replay(recorded(episode, ACTION, env.stack.action_space))
    errors: dict[str, list[float]] = {}
    last = None
    for last in maker.play(episode, agent, {"state": states[0]}, len(states) - 1):
        for name, error in deviation(before[last.row], Poses.of(env)).items():
            errors.setdefault(name, []).append(error)
    assert last is not None, "the reset always yields"
    result = ReexecutionResult(
        episode_id=episode.id,
        recorded_success=episode.success,
        success=last.success,
        recorded_steps=len(states) - 1,
        steps=last.row,
        errors=errors,
    )
    maker.keep(episode, last, {"errors": result.summary()})
    return result


def _restored(env: Env, states: NDArray[np.float64]) -> Iterator[Poses]:
    """Restore the recorded states one after the other, and yield their poses."""
    world = env.simulation.world
    for state in states:
        world.core.set_state(state)
        world.refresh()
        yield Poses.of(env)
