"""Collect a dataset of scripted episodes, on one process or several.

Episode i depends on the seed of the collection and on i alone, so that the number of workers, an interruption and a
resumption change nothing in the data.
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

# The id of an attempt, as `episode_id` makes it.
_ATTEMPT = re.compile(r"\d{6,}")


@dataclass(frozen=True, kw_only=True)
class Collection:
    """What to collect."""

    setup: Setup
    out: Path
    """The dataset's folder."""
    episodes: int
    """How many episodes the dataset shall have in the end; those count that the task has judged."""
    seed: int = 0
    """Same seed, same data."""
    only_success: bool = False
    """Keep successful episodes only, and try until there are enough."""
    workers: int = 1
    """Processes; one works in this process."""
    colour: Colour = "jpeg"
    """How colour frames are stored."""
    jpeg_quality: int = 95
    """Of colour frames as JPEG, 1 to 100."""
    agent: Any = None
    """An agent's class or name, `module:Class`; None for the expert of the task."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number that makes no sense.
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
        """Return the seed of an attempt; those of two collections with different seeds do not overlap."""
        return seed_of(self.seed, attempt)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of an episode of a collection or evaluation; those of different seeds do not overlap."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One attempt that was made."""

    number: int
    result: EpisodeResult


@dataclass
class Progress:
    """How far a collection is."""

    kept: int = 0
    """Episodes in the dataset, with those of earlier runs."""
    found: int = 0
    """Episodes that were there at the start, and complete."""
    again: int = 0
    """Attempts that were there in part, cut short by a kill, and are made again from their start."""
    attempts: list[Attempt] = field(default_factory=list[Attempt])
    """Attempts of this run, in the order in which they ended."""
    is_interrupted: bool = False
    seconds: float = 0.0
    """Wall time of this run [s]."""


def episode_id(number: int) -> str:
    """Return the id of an attempt's episode."""
    return f"{number:06d}"


class Collector:
    """Makes attempts and keeps episodes: the part of a collection that one process does."""

    def __init__(self, collection: Collection, writer: DatasetWriter, env: Env | None = None) -> None:
        """Make the environment and the expert."""
        self._collection = collection
        self._env = env or make(collection.setup)
        self._recorder = Recorder(writer)
        self._env.add_observer(self._recorder)
        self._agent = agent_for(self._env, collection.agent)

    def attempt(self, number: int) -> Attempt:
        """Make one attempt, and keep it if it is to be kept."""
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

    Attempts that an earlier collection left half done, recovered or not, are made again from their start.

    Closing the iterator, or setting `progress.is_interrupted`, ends the collection after the episodes at work; the
    dataset stays resumable.

    Args:
        collection: What to collect.
        progress: Updated while it runs.
        env: An environment of the collection's setup to use in this process; made when not given. It is closed in the
            end.

    Raises:
        DatasetError: The dataset cannot be written, is locked, or belongs to another setup.
        InvalidSetup: The setup makes no sense.
    """
    env = env or make(collection.setup)
    try:
        agent_for(env, collection.agent).close()
        info = dataset_info(env, colour=collection.colour, jpeg_quality=collection.jpeg_quality)
        # How an episode is numbered and seeded is part of what makes two collections the same.
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
    """Remove the attempts that no task judged, and return how many there were.

    A kill cut these short, and they were recovered since. An attempt depends on the seed and its number alone, so all
    their rows are recorded again, and the dataset becomes that of a collection that nothing ended.
    """
    fragments = [e.id for e in Dataset.open(writer.path) if e.success is None and _ATTEMPT.fullmatch(e.id)]
    for name in fragments:
        writer.remove_episode(name)
    return len(fragments)


def _numbers(collection: Collection, progress: Progress, taken: set[str]) -> Iterator[int]:
    """Give out the numbers of attempts until enough episodes are kept."""
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
    # Attempts of other workers were under way when the last one succeeded. Those with the lowest numbers stay, so that
    # the dataset does not depend on who was faster.
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
    """What a worker process does; sent to it once."""

    collection: Collection

    def __call__(self) -> Collector:
        return Collector(self.collection, DatasetWriter.join(self.collection.out))
