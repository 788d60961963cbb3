"""Replay recorded episodes in simulation and compare the states bit for bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents import Replay
from rcs.data import Dataset, EpisodeRecord
from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.envs.observers.recorder import ACTION
from rcs.rollout.look import physics_of, require_rate, require_states, setup_of
from rcs.setups.make import resolve

__all__ = ["ReplayResult", "physics_of", "replay", "replay_episode", "setup_of"]


@dataclass(frozen=True, kw_only=True)
class ReplayResult:
    """How a replay compares to its recording."""

    episode_id: str
    steps: int
    first_difference: int | None
    """Row of the first state that differs in any bit; None when all are equal."""

    @property
    def is_equal(self) -> bool:
        """Whether every state was equal, bit for bit."""
        return self.first_difference is None


def replay(path: str | Path) -> Iterator[ReplayResult]:
    """Play every episode's actions from its first state, without cameras, and compare all states.

    Args:
        path: The dataset.

    Raises:
        InvalidSetup: The dataset is not from simulation.
        DatasetError, CorruptEpisode: The dataset cannot be read.
    """
    dataset = Dataset.open(path)
    require_states(dataset)
    require_rate(dataset)
    # Cameras look and change nothing; without their frames a replay is ten times faster. Looks change nothing either.
    env = assemble(resolve(dataclasses.replace(physics_of(dataset), assets="builtin")), is_blind=True)
    try:
        for episode in dataset.episodes:
            yield replay_episode(env, episode)
    finally:
        env.close()


def replay_episode(env: Env, episode: EpisodeRecord) -> ReplayResult:
    """Play one episode's actions from its first state and compare all states."""
    states = episode.sim_state()
    agent = Replay(recorded(episode, ACTION, env.stack.action_space))
    observation, info = env.reset(seed=episode.seed, options={"state": states[0]})
    agent.reset(observation, info)
    world = env.scenario.world
    first_difference = None if _equal(world.states(), states[0]) else 0
    for row in range(1, len(states)):
        if first_difference is not None:
            break
        observation, _, terminated, truncated, info = env.step(agent.act(observation, info))
        if not _equal(world.states(), states[row]) or ((terminated or truncated) and row + 1 < len(states)):
            first_difference = row
    return ReplayResult(episode_id=episode.id, steps=len(states) - 1, first_difference=first_difference)


def recorded(episode: EpisodeRecord, prefix: str, space: spaces.Dict) -> dict[str, Any]:
    """Read what was recorded of all steps under a prefix such as `action`, nested as a space is: (steps, ...) each.

    Raises:
        InvalidSetup: The dataset has other features.
        CorruptEpisode: The episode is damaged.
    """
    return {
        key: recorded(episode, f"{prefix}/{key}", inner)
        if isinstance(inner, spaces.Dict)
        else episode.column(f"{prefix}/{key}")[1:]
        for key, inner in space.spaces.items()
    }


def _equal(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return a.tobytes() == b.tobytes()
