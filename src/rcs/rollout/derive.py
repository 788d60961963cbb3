"""Derives a dataset from another one in simulation, episode by episode, whole or not at all."""

from __future__ import annotations

import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, ClassVar

from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord
from rcs_data.output import new_output

from rcs.agents import Agent
from rcs.envs.assemble import compose
from rcs.envs.env import Env
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup
from rcs.rollout.look import Look, Stage, physics_of, varied
from rcs.rollout.pool import WorkerPool
from rcs.rollout.replay import Step, play
from rcs.setups.make import resolve
from rcs.sim.state_transfer import StateTransfer

SOURCE = "source"
"""Key of an outcome: the episode that this one was made from."""


@dataclass(frozen=True, kw_only=True)
class Derivation(ABC):
    """The recipe of a derived dataset; `derive` makes it."""

    kind: ClassVar[str]
    """The kind of replay, stored in outcomes."""

    source: Path
    """Folder of the dataset."""
    out: Path
    """Folder of the new dataset; it must not exist."""
    look: Look = field(default_factory=Look)
    workers: int = 1
    """Number of processes; 1 for this one, 0 for one per core."""
    trust: tuple[str, ...] = ()
    """Modules that may be imported because the dataset's setup names them, such as `my_tasks`."""

    @abstractmethod
    def stage(self, dataset: Dataset) -> Stage:
        """Return the stage of the new episodes.

        Raises:
            InvalidSetup: The dataset cannot be replayed in this way, or an option is not valid.
        """

    def info(self, dataset: Dataset, stage: Stage, env: Env) -> DatasetInfo:
        """Return the info of the new dataset, and check what requires an environment.

        Raises:
            InvalidSetup: The dataset does not fit the environment.
        """
        return stage.info(env, dataset.info)

    @abstractmethod
    def make(self, workplace: Workplace, episode: EpisodeRecord) -> Any:
        """Make an episode from a recorded one, and return the result."""

    def give_up(self, episode: EpisodeRecord, error: InvalidSetup) -> Any:
        """Return the result for an episode that could not be made, or raise the error if all others would fail too."""
        raise error


class Workplace:
    """Where one process makes episodes: an environment, the recorded dataset and the new one."""

    def __init__(self, job: Derivation, out: Path, rows: Synchronized[int] | None) -> None:
        """Open the one dataset, join the other, and make the environment."""
        self.job = job
        self.dataset = Dataset.open(job.source)
        self.stage = job.stage(self.dataset)
        self.writer = DatasetWriter.join(out)
        self.env, self._looks = self.stage.env()
        self.recorder = Recorder(self.writer)
        self.env.add_observer(self.recorder)
        self._rows = rows

    @cached_property
    def transfer(self) -> StateTransfer:
        """Transfers recorded simulation states to the scene of the environment."""
        source = compose(resolve(replace(physics_of(self.dataset, trust=self.job.trust), assets="builtin"))).compile()
        return StateTransfer(source, self.env.scenario.world.model)

    def attempt(self, number: int) -> Any:
        """Make an episode, given its number in the dataset."""
        episode = self.dataset.episodes[number]
        if self._looks is not None:
            self._looks.episode_id = episode.id
        try:
            with self.recorder.discard_on_error():
                return self.job.make(self, episode)
        except InvalidSetup as err:
            self.recorder.forget_next()
            return self.job.give_up(episode, err)

    def play(
        self, episode: EpisodeRecord, agent: Agent, options: Mapping[str, Any], most: int, see: Callable[[Step], None]
    ) -> Step:
        """Let an agent act from a given start, record that under the recorded episode's id, and return the end.

        Args:
            episode: The recorded episode.
            agent: The agent.
            options: Options of the reset: the start.
            most: Largest number of steps.
            see: Called after the reset and after every step.
        """
        self.recorder.name_next(episode.id, instruction=episode.instruction)
        step: Step | None = None
        for step in play(self.env, agent, seed=episode.seed, options=options, most=most):
            see(step)
            self.count_row()
        assert step is not None, "the reset always yields"
        return step

    def count_row(self) -> None:
        """Count a new row, for progress bars."""
        if self._rows is not None:
            with self._rows.get_lock():
                self._rows.value += 1

    def outcome(self, episode: EpisodeRecord, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the outcome's entries about randomisation and source of an episode.

        Args:
            episode: The source.
            more: Further entries about it.
        """
        source = {
            "dataset": self.dataset.path.resolve().name,
            "episode": episode.id,
            "content_hash": episode.content_hash,
            "kind": self.job.kind,
            SOURCE: episode.outcome.get(SOURCE, episode.source),  # its own source
        }
        return {**varied(self.env), SOURCE: {**source, **(more or {})}}

    def keep(self, episode: EpisodeRecord, last: Step, more: Mapping[str, Any]) -> None:
        """Keep the recording up to a last step; see `outcome`."""
        failure = None if last.success else "replay"
        self.recorder.finish(last.success, {"failure": failure, "reward": last.reward, **self.outcome(episode, more)})

    def close(self) -> None:
        """Close the environment and the writer."""
        self.env.close()
        self.writer.close()


@dataclass(frozen=True)
class _Work:
    """Makes a workplace in its process; sent to it once."""

    job: Derivation
    out: Path
    rows: Synchronized[int] | None

    def __call__(self) -> Workplace:
        return Workplace(self.job, self.out, self.rows)


def derive(job: Derivation, rows: Synchronized[int] | None = None) -> Iterator[Any]:
    """Make a dataset, and yield the result of each episode as it is done.

    Args:
        job: What to make.
        rows: Counts the new rows across processes; None for no count. See `row_counter`.

    Raises:
        InvalidSetup: The dataset cannot be replayed in this way, or an option is not valid.
        DatasetError, CorruptEpisode: A dataset cannot be read or written, or `out` is not empty.
    """
    if not isinstance(job.workers, int) or job.workers < 0:
        raise InvalidSetup(f"workers is {job.workers!r}; valid is 0 (one per core) and more.")
    dataset = Dataset.open(job.source)
    stage = job.stage(dataset)
    job = replace(job, trust=tuple(sys.modules))  # what is imported here may be imported by the workers
    env, _ = stage.env()
    try:
        info = job.info(dataset, stage, env)
    finally:
        env.close()
    processes = min(job.workers or os.cpu_count() or 1, max(len(dataset), 1))
    with new_output(job.out) as folder, DatasetWriter.open(folder, info):
        work = _Work(job, folder, rows)
        if processes > 1:
            with WorkerPool(work, processes) as pool:
                yield from pool.map(iter(range(len(dataset))))
            return
        workplace = work()
        try:
            yield from map(workplace.attempt, range(len(dataset)))
        finally:
            workplace.close()


def row_counter() -> Synchronized[int]:
    """Return a counter that processes share, at 0."""
    return get_context("spawn").Value("q", 0)
