"""The ways of a task's scripted expert, to compare with those of another agent in the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rcs_data.diversity import diversity_of_ways

from rcs.agents import agent_for
from rcs.devices import lookup
from rcs.envs.observer import Observer, Transition
from rcs.envs.setup import Setup
from rcs.envs.spaces import JOINTS
from rcs.rollout.collect import Collection
from rcs.rollout.episode import run_episode
from rcs.setups.make import make

COMPARED = 20
"""Episodes of the expert; without cameras, each takes a second or two."""


def expert_diversity(collection: Collection) -> float | None:
    """Return by how much the expert's ways differ in the first episodes of a collection by another agent [rad].

    None if the collection is the expert's own, there are no two episodes, or the task has no expert.
    """
    seeds = [collection.seed_of(number) for number in range(min(collection.episodes, COMPARED))]
    has_expert = getattr(lookup.find("task", collection.setup.task), "expert", None) is not None
    if collection.agent is None or len(seeds) < 2 or not has_expert:
        return None
    return diversity_of_ways(expert_ways(collection.setup, seeds))


def expert_ways(setup: Setup, seeds: Sequence[int]) -> list[NDArray[np.float64]]:
    """Return the joints [rad] at every step of the expert's episodes, (rows, joints of all robots) each."""
    bare = replace(setup, cameras=())
    watch = _Watch()
    with make(bare) as env:
        agent = agent_for(env)
        env.add_observer(watch)
        try:
            for seed in seeds:
                run_episode(env, agent, seed=seed)
        finally:
            agent.close()
    return [np.array(rows) for rows in watch.ways]


class _Watch(Observer):
    """Keeps the joints of every step."""

    def __init__(self) -> None:
        self.ways: list[list[NDArray[np.float64]]] = []

    def on_reset(self, first: Transition, seed: int | None) -> None:
        self.ways.append([])
        self.on_step(first)

    def on_step(self, transition: Transition) -> None:
        seen = transition.observation
        parts = [seen] if JOINTS in seen else [part for part in seen.values() if JOINTS in part]
        self.ways[-1].append(np.concatenate([part[JOINTS] for part in parts], dtype=np.float64))
