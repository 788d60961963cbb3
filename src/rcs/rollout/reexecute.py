"""Executes episodes again in simulation, judges them, and measures how far they deviate from the recording.

Recorded actions are executed from the first recorded state. Or the simulated robot follows recorded joints and gripper
openings, those of a real robot too: then the task's objects are placed according to `outcome["objects"]`, their poses
at the start by name, translation [m] and quaternion xyzw in the base frame of the robot (with several robots: in the
scene).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from rcs_data import Dataset, EpisodeRecord

from rcs.agents import Agent, Replay
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import ACTION, OBJECTS, require_recordable
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.derived_dataset import Derivation, EpisodeMaker, derive
from rcs.rollout.episode import Step, play
from rcs.rollout.recorded_motion import RecordedMotion, find_states
from rcs.rollout.recorded_setup import physics_of, require_rate, require_states, seen_as, setup_of
from rcs.rollout.replay import recorded
from rcs.spatial import distance

Kind = Literal["actions", "states"]
"""The motion to execute: the recorded actions, or targets that follow the recorded joints and openings."""


@dataclass(frozen=True, kw_only=True)
class ReexecutionResult:
    """The result of an episode that was executed again."""

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


def reexecute(
    source: str | Path,
    out: str | Path,
    *,
    kind: Kind = "actions",
    setup: Setup | None = None,
    looks_seed: int | None = None,
    only_success: bool = False,
    grace: float = 1.0,
    workers: int = 1,
    trust: Collection[str] = (),
) -> Iterator[ReexecutionResult]:
    """Execute every episode again, and record the results in a new dataset.

    Args:
        source: Folder of the recorded dataset.
        out: Folder of the new dataset; it must not exist.
        kind: The motion to execute.
        setup: The setup of the new episodes, None for the recorded one. Those of actions may differ in what is seen
            only, see `seen_as`. Those of states have absolute joint targets and stiff arms that go on after a
            collision, since the measured ones have given way already and have gone on.
        looks_seed: Seed of the appearance of episodes; None for the recorded one.
        only_success: Keep successful episodes only.
        grace: How long to hold the last state if the task is not done yet, of states [s].
        workers: Number of processes; 1 for this one, 0 for one per core.
        trust: Modules that may be imported because the dataset's setup names them.

    Raises:
        InvalidSetup: The dataset has no simulation states or was resampled, it does not fit the robots, no episode has
            the objects' poses, or an option is not valid.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    if not 0 <= grace < np.inf:
        raise InvalidSetup(f"grace is {grace} s; valid is 0 and more.")
    if kind not in get_args(Kind):
        raise InvalidSetup(f"kind is {kind!r}; valid: {', '.join(map(repr, get_args(Kind)))}.")
    dataset = Dataset.open(source)
    if kind == "actions":
        require_states(dataset)
        physics, frames = physics_of(dataset, trust=trust), setup_of(dataset, trust=trust)
        require_rate(dataset, physics)
        setup = seen_as(frames, setup, looks_seed)
    else:
        try:
            physics = setup = seen_as(_following(setup or setup_of(dataset, trust=trust)), None, looks_seed)
        except InvalidSetup as err:
            raise err if setup is not None else InvalidSetup(f"{err} Or give a setup with a robot and a task.") from err
    make = partial(_execute, kind=kind, only_success=only_success, grace=grace)
    recipe = Derivation(kind=kind, source=Path(source), physics=physics, setup=setup, looks_seed=looks_seed, make=make)
    with closing(recipe.open()[0]) as env:
        if kind == "states":
            names = sorted(env.simulation.task.object_poses())
            if names and not any(OBJECTS in episode.outcome for episode in dataset.episodes):
                raise InvalidSetup(
                    f"No episode of {dataset.path} has poses of the objects {', '.join(names)}. Record them as "
                    "outcome['objects'] = {name: [x, y, z, qx, qy, qz, qw]} in the robot's base frame."
                )
            find_states(dataset.info, env.simulation.robots, setup.binary_gripper)
        info = recipe.info(env, dataset.info)
    yield from derive(recipe, Path(out), info, workers)


def _following(setup: Setup) -> Setup:
    """Return a setup whose arms follow what other arms have done."""
    setup = replace(
        setup,
        control="joints",
        relative="absolute",
        stepping="async" if setup.stepping == "realtime" else setup.stepping,
        max_episode_steps=None,
        compliance=None,
        collision_reaction=False,
    )
    require_recordable(setup)
    return setup


_Plan = tuple[Agent, Mapping[str, Any], int, Callable[[Step], Mapping[str, float]]]
"""Agent, options of the reset, largest number of steps, and the deviations of a step."""


def _execute(
    maker: EpisodeMaker, episode: EpisodeRecord, *, kind: Kind, only_success: bool, grace: float
) -> ReexecutionResult:
    """Make one episode."""
    try:
        with maker.recorder.discard_on_error():
            plan = _states(maker, episode, grace) if kind == "states" else _actions(maker, episode)
            return _executed(maker, episode, plan, only_success)
    except InvalidSetup as err:
        if kind == "actions":
            raise
        # Joints out of limits, missing poses or an explosion concern this episode only.
        maker.recorder.forget_next()
        return ReexecutionResult(
            episode_id=episode.id, recorded_success=episode.success, success=False, problem=str(err)
        )


def _executed(maker: EpisodeMaker, episode: EpisodeRecord, plan: _Plan, only_success: bool) -> ReexecutionResult:
    """Make an episode as planned, and keep it if it is wanted."""
    agent, start, most, compare = plan
    errors: dict[str, list[float]] = {}
    last: Step | None = None
    maker.recorder.name_next(episode.id, instruction=episode.instruction)
    with closing(play(maker.env, agent, seed=episode.seed, options=start, max_steps=most)) as steps:
        for last in steps:
            for name, error in compare(last).items():
                errors.setdefault(name, []).append(error)
    assert last is not None, "the reset always yields"
    result = ReexecutionResult(
        episode_id=episode.id,
        recorded_success=episode.success,
        success=bool(last.info.get("success", False)),
        recorded_steps=episode.length - 1,
        steps=last.row,
        errors=errors,
    )
    if result.success or not only_success:
        failure = None if result.success else "replay"
        more = {"errors": result.summary(), "success": episode.success}
        outcome = {"failure": failure, "reward": last.reward, **maker.outcome(episode, more)}
        maker.recorder.finish(result.success, outcome)
    else:
        maker.recorder.discard()
    return result


def _actions(maker: EpisodeMaker, episode: EpisodeRecord) -> _Plan:
    """Execute the recorded actions from the first recorded state."""
    env, states = maker.env, maker.transfer(episode.sim_state())
    before = [*_restored(env, states)]
    agent = Replay(recorded(episode, ACTION, env.stack.action_space))
    return agent, {"state": states[0]}, len(states) - 1, lambda step: deviation(before[step.row], poses_of(env))


def _states(maker: EpisodeMaker, episode: EpisodeRecord, grace: float) -> _Plan:
    """Follow the recorded joints and openings; the objects are where they were recorded."""
    setup, simulation = maker.env.setup, maker.env.simulation
    motion = RecordedMotion(episode, simulation.robots, setup.binary_gripper, setup.frequency)
    start: dict[str, Any] = {"robot": motion.start()}
    if simulation.task.object_poses():
        if OBJECTS not in episode.outcome:
            raise InvalidSetup("The objects' poses are unknown.")
        start[OBJECTS] = episode.outcome[OBJECTS]

    def compare(step: Step) -> dict[str, float]:
        time = step.row / setup.frequency
        return {"joints": motion.error(step.observation, time)} if time <= motion.duration else {}

    return motion, start, int(np.ceil((motion.duration + grace) * setup.frequency - 1e-9)), compare


def poses_of(env: Env) -> dict[str, NDArray[np.float64]]:
    """Return joints (n,) [rad] of all robots, `tcps` (robots, 7) and `objects` (objects, 7) [m], xyzw."""
    robots = env.simulation.robots
    return {
        "joints": np.concatenate([robot.joints for robot in robots]),
        "tcps": np.stack([robot.tcp_tquat for robot in robots]),
        "objects": np.array(list(env.simulation.object_poses().values())).reshape(-1, 7),
    }


def deviation(before: Mapping[str, NDArray[np.float64]], now: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
    """Return the largest deviations of all joints, TCPs and objects, given those of `poses_of`.

    Returns:
        `joints` [rad], `position` [m] and `rotation` [rad] of the TCP, and `object_position` [m] and `object_rotation`
        [rad] if there are objects.
    """
    found = {"joints": float(np.abs(before["joints"] - now["joints"]).max())}
    for key, prefix in (("tcps", ""), ("objects", "object_")):
        if len(before[key]):
            position, rotation = distance(before[key], now[key]).max(axis=0)
            found |= {f"{prefix}position": float(position), f"{prefix}rotation": float(rotation)}
    return found


def _restored(env: Env, states: NDArray[np.float64]) -> Iterator[dict[str, NDArray[np.float64]]]:
    """Restore the recorded states one after the other, and yield their poses."""
    world = env.simulation.world
    for state in states:
        world.core.set_state(state)
        world.refresh()
        yield poses_of(env)
