"""Makes a dataset from another one, episode by episode, on one process or several; it is there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcs.data import DatasetInfo, DatasetWriter, EpisodeRecord
from rcs.data.output import new_output
from rcs.errors import InvalidSetup
from rcs.rollout.pool import Worker, WorkerPool

SOURCE = "source"
"""Key of an outcome: the episode that this one was made from."""


@dataclass(frozen=True)
class Work:
    """Makes a worker in its process; sent to it once."""

    make: Callable[[Path], Worker]
    """Makes the worker, given the new dataset to join; is pickled."""
    out: Path
    """The new dataset."""

    def __call__(self) -> Worker:
        """Make the worker."""
        return self.make(self.out)


def derive(
    out: str | Path, info: DatasetInfo, make: Callable[[Path], Worker], episodes: Sequence[int], workers: int = 1
) -> Iterator[Any]:
    """Make a dataset, and yield the answers of the workers as they come.

    Args:
        out: Folder of the new dataset; nothing may be there.
        info: What its episodes share.
        make: Makes a worker, given a folder whose dataset it joins as a writer; picklable.
        episodes: Numbers for the workers to answer, such as those of the episodes of a source.
        workers: Processes; one works in this process.

    Raises:
        DatasetError: There is something in `out`, or the disk fails.
        RcsError: A worker failed.
    """
    if not isinstance(workers, int) or workers < 0:
        raise InvalidSetup(f"workers is {workers!r}; valid is 0 (one per core) and more.")
    processes = min(workers or os.cpu_count() or 1, max(len(episodes), 1))
    with new_output(out) as folder, DatasetWriter.open(folder, info):
        work = Work(make, folder)
        if processes == 1:
            worker = work()
            try:
                for number in episodes:
                    yield worker.attempt(number)
            finally:
                worker.close()
        else:
            with WorkerPool(work, processes) as pool:
                yield from pool.map(iter(episodes))


def source_of(episode: EpisodeRecord, dataset: Path, mode: str) -> dict[str, Any]:
    """Return what an outcome keeps of the episode that another was made from, with what that was made from.

    Args:
        episode: The episode.
        dataset: The folder of its dataset.
        mode: How the other was made.
    """
    return {
        "dataset": dataset.resolve().name,
        "episode": episode.id,
        "content_hash": episode.content_hash,
        "mode": mode,
        SOURCE: episode.outcome.get(SOURCE, episode.source),
    }
