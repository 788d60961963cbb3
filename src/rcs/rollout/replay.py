"""Replays recorded actions in simulation and compares all states bit for bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gymnasium import spaces
from rcs_data import Dataset, EpisodeRecord

from rcs.agents import Replay
from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import ACTION
from rcs.errors import InvalidSetup
from rcs.rollout.episode import play
from rcs.rollout.recorded_setup import physics_of, require_rate, require_states
from rcs.setups.make import resolve
from rcs.sim.state_transfer import of_another_simulation


@dataclass(frozen=True, kw_only=True)
class ReplayResult:
    """Comparison of a replay with its recording."""

    episode_id: str
    steps: int
    first_difference: int | None
    """Row of the first state that differs in any bit; None when all are equal."""
    begins_at_reset: bool = True
    """False if a state differs and the first state is not the one after a reset with the episode's seed, as after a
    trim: then the servos' targets at the start are unknown."""

    @property
    def is_equal(self) -> bool:
        """Whether every state was equal, bit for bit."""
        return self.first_difference is None

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return dataclasses.asdict(self)


def replay(path: str | Path, *, trust: Collection[str] = ()) -> Iterator[ReplayResult]:
    """Play every episode's actions from its first state, without cameras, and compare all states.

    Args:
        path: The dataset.
        trust: Modules that may be imported because the dataset's setup names them.

    Raises:
        InvalidSetup: The dataset is not from simulation, or its setup names a module that is not trusted.
        DatasetError, CorruptEpisode: The dataset cannot be read.
    """
    dataset = Dataset.open(path)
    require_states(dataset)
    setup = dataclasses.replace(physics_of(dataset, trust=trust), assets="builtin")
    require_rate(dataset, setup)
    # Neither cameras nor their appearance change the physics, and without frames a replay is ten times faster.
    with closing(assemble(resolve(setup), drawn=())) as env:
        own = env.simulation.world.core.state_size
        for episode in dataset.episodes:
            if dataset.info.sim_state_size != own:
                raise InvalidSetup(of_another_simulation(dataset.info.sim_state_size or 0, own))
            yield replay_episode(env, episode)


def replay_episode(env: Env, episode: EpisodeRecord) -> ReplayResult:
    """Play one episode's actions from its first state and compare all states."""
    states = episode.sim_state()
    most = len(states) - 1
    agent = Replay(recorded(episode, ACTION, env.stack.action_space))
    first_difference: int | None = None
    with closing(play(env, agent, seed=episode.seed, options={"state": states[0]}, max_steps=most)) as steps:
        for step in steps:
            is_equal = env.simulation.world.states().tobytes() == states[step.row].tobytes()
            if not is_equal or (step.is_over and step.row < most):
                first_difference = step.row
                break
    begins_at_reset = True
    if first_difference is not None:
        env.reset(seed=episode.seed)
        begins_at_reset = env.simulation.world.states().tobytes() == states[0].tobytes()
    return ReplayResult(
        episode_id=episode.id, steps=most, first_difference=first_difference, begins_at_reset=begins_at_reset
    )


def recorded(episode: EpisodeRecord, prefix: str, space: spaces.Dict) -> dict[str, Any]:
    """Read the columns of all steps under a prefix such as `action`, nested like a space: (steps, ...) each.

    Raises:
        InvalidSetup: The dataset lacks a feature.
        CorruptEpisode: The episode is damaged.
    """
    return {
        key: recorded(episode, f"{prefix}/{key}", inner)
        if isinstance(inner, spaces.Dict)
        else episode.column(f"{prefix}/{key}")[1:]
        for key, inner in space.spaces.items()
    }
