"""Collects a dataset of scripted episodes, in one process or several.

Episode i depends only on the seed of the collection and on i, so the number of workers, interruption and resumption do
not change the data.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcs.agents import agent_for
from rcs.data import Dataset, DatasetWriter
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observers.recorder import Colour, Recorder, dataset_info, require_recordable
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.episode import EpisodeResult, run_episode
from rcs.rollout.pool import WorkerPool
from rcs.setups.make import make

_log = logging.getLogger(__name__)

# The id of an attempt, made by `episode_id`.
_ATTEMPT = re.compile(r"\d{6,}")


@dataclass(frozen=True, kw_only=True)
class Collection:
    """What to collect."""

    setup: Setup
    out: Path
    """The dataset's folder."""
    episodes: int
    """Number of episodes in the finished dataset; only those judged by the task count."""
    seed: int = 0
    """Same seed, same data."""
    only_success: bool = False
    """Keep successful episodes only, and try until there are enough."""
    workers: int = 1
    """Processes; one works in this process."""
    colour: Colour = "jpeg"
    """Encoding of colour frames."""
    jpeg_quality: int = 95
    """JPEG quality of colour frames, 1 to 100."""
    agent: Any = None
    """An agent's class or name, `module:Class`; None for the expert of the task."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is not valid.
        """
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InvalidSetup(f"{name} is {value}; valid is {least} and more.")
        require_recordable(self.setup)

    @property
    def agent_name(self) -> str | None:
        """Name of the agent; None for the expert of the task."""
        return None if self.agent is None else lookup.name_of("agent", self.agent)

    def seed_of(self, attempt: int) -> int:
        """Return the seed of an attempt; collections with different seeds share none."""
        return seed_of(self.seed, attempt)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of an episode of a collection or evaluation; different seeds share no episodes."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One finished attempt."""

    number: int
    result: EpisodeResult


@dataclass
class Progress:
    """The progress of a collection."""

    kept: int = 0
    """Episodes in the dataset, including those of earlier runs."""
    found: int = 0
    """Complete episodes at the start of this run."""
    again: int = 0
    """Attempts cut short by a kill, which are made again from the start."""
    attempts: list[Attempt] = field(default_factory=list[Attempt])
    """Attempts of this run, in the order of their ends."""
    is_interrupted: bool = False
    seconds: float = 0.0
    """Wall time of this run [s]."""


def episode_id(number: int) -> str:
    """Return the id of an attempt's episode."""
    return f"{number:06d}"


class Collector:
    """Makes attempts and keeps episodes: one process of a collection."""

    def __init__(self, collection: Collection, writer: DatasetWriter, env: Env | None = None) -> None:
        """Make the environment and the expert."""
        self._collection = collection
        self._env = env or make(collection.setup)
        self._recorder = Recorder(writer)
        self._env.add_observer(self._recorder)
        self._agent = agent_for(self._env, collection.agent)

    def attempt(self, number: int) -> Attempt:
        """Make one attempt, and keep it if the collection wants it."""
        self._recorder.name_next(episode_id(number))
        with self._recorder.discard_on_error():
            return self._attempt(number)

    def _attempt(self, number: int) -> Attempt:
        result = run_episode(self._env, self._agent, seed=self._collection.seed_of(number))
        if result.success or not self._collection.only_success:
            drawn = {field: values.tolist() for field, values in self._env.scenario.randomisation.items()}
            outcome = {"attempt": number, **result.outcome(), **({"randomisation": drawn} if drawn else {})}
            self._recorder.finish(result.success, outcome)
        else:
            self._recorder.discard()
        return Attempt(number=number, result=result)

    def close(self) -> None:
        """Close agent and environment."""
        try:
            self._agent.close()
        finally:
            self._env.close()


def collect(collection: Collection, progress: Progress, env: Env | None = None) -> Iterator[Attempt]:
    """Collect until the dataset is complete, yielding every attempt as it ends.

    Attempts that an earlier collection left unfinished, recovered or not, are made again from the start. Closing the
    iterator, or setting `progress.is_interrupted`, ends the collection after the running episodes; the dataset stays
    resumable.

    Args:
        collection: What to collect.
        progress: Updated while it runs.
        env: An environment of the collection's setup to use in this process; None for a new one. It is closed at the
            end.

    Raises:
        DatasetError: The dataset cannot be written, is locked, or belongs to another setup.
        InvalidSetup: The setup is not valid.
    """
    env = env or make(collection.setup)
    try:
        agent_for(env, collection.agent).close()
        info = dataset_info(env, colour=collection.colour, jpeg_quality=collection.jpeg_quality)
        # Two collections are the same only if they number and seed episodes alike.
        made = {"seed": collection.seed, "only_success": collection.only_success, "agent": collection.agent_name}
        info = replace(info, origin={**info.origin, "collection": made})
        with DatasetWriter.open(collection.out, info, resume=True, leftovers="discard") as writer:
            progress.again = _remove_fragments(writer)
            taken = {episode.id for episode in Dataset.open(collection.out)}
            progress.kept = progress.found = len(taken)
            start = time.perf_counter()
            numbers = _numbers(collection, progress, taken)
            try:
                if collection.workers == 1:
                    yield from _collect_here(collection, writer, env, numbers, progress)
                else:
                    env.close()
                    yield from _collect_in_pool(collection, writer, numbers, progress)
            finally:
                progress.seconds = time.perf_counter() - start
    finally:
        env.close()


def _remove_fragments(writer: DatasetWriter) -> int:
    """Remove the attempts without a verdict, and return how many there were.

    A kill cut them short, and they were recovered since. An attempt depends only on the seed and its number, so
    recording them again gives the dataset of an uninterrupted collection.
    """
    fragments = [e.id for e in Dataset.open(writer.path) if e.success is None and _ATTEMPT.fullmatch(e.id)]
    for name in fragments:
        writer.remove_episode(name)
    return len(fragments)


def _numbers(collection: Collection, progress: Progress, taken: set[str]) -> Iterator[int]:
    """Yield numbers of attempts until enough episodes are kept."""
    number = 0
    while not progress.is_interrupted:
        if collection.only_success:
            if progress.kept >= collection.episodes:
                return
        elif number >= collection.episodes:
            return
        if episode_id(number) not in taken:
            yield number
        number += 1


def _collect_here(
    collection: Collection, writer: DatasetWriter, env: Env, numbers: Iterator[int], progress: Progress
) -> Iterator[Attempt]:
    collector = Collector(collection, writer, env)
    for number in numbers:
        attempt = collector.attempt(number)
        _count(attempt, collection, progress)
        yield attempt


def _collect_in_pool(
    collection: Collection, writer: DatasetWriter, numbers: Iterator[int], progress: Progress
) -> Iterator[Attempt]:
    with WorkerPool(_Work(collection), collection.workers) as pool:
        for attempt in pool.map(numbers):
            _count(attempt, collection, progress)
            yield attempt
    # Other workers had running attempts when the last one succeeded. Those with the lowest numbers stay, so that the
    # dataset does not depend on the workers' speed.
    kept = [episode.id for episode in Dataset.open(collection.out).episodes]
    if collection.only_success and not progress.is_interrupted:
        for surplus in sorted(kept)[collection.episodes :]:
            writer.remove_episode(surplus)
        progress.kept = min(len(kept), collection.episodes)


def _count(attempt: Attempt, collection: Collection, progress: Progress) -> None:
    progress.attempts.append(attempt)
    progress.kept += bool(attempt.result.success) or not collection.only_success


@dataclass(frozen=True)
class _Work:
    """Makes the worker in its process; sent to it once."""

    collection: Collection

    def __call__(self) -> Collector:
        return Collector(self.collection, DatasetWriter.join(self.collection.out))
