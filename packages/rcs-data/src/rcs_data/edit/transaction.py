"""Transactions: a new generation of a dataset's episodes, or a new dataset, takes effect only when complete.

Episodes are never changed. In a new generation, an unchanged one is a folder of links to the same files. Nothing reads
a generation before `dataset.json` names it, and the next edit removes what a kill left of it.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.compact import seal
from rcs_data.durable import copy_file, disk_errors, link_file, remove_tree, sealed, sync_folder, write_file
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.head import Edit, Head, read_head, write_head
from rcs_data.info import DatasetInfo
from rcs_data.layout import (
    EPISODE_FILE,
    FRAMES_FILE,
    STEPS_FILE,
    check_episode_id,
    complete_ids,
    episode_folder,
    episodes_folder,
    generation_folder,
    generations,
    open_ids,
)
from rcs_data.lock import DatasetLock
from rcs_data.output import new_output
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.recover import unreachable_generations


class EpisodeFolder:
    """A folder that is being filled with complete episodes."""

    def __init__(self, base: Path, info: DatasetInfo, place: Callable[[Path, Path], object]) -> None:
        """Start with no episodes.

        Args:
            base: Its episodes go to `base/episodes`.
            info: What they share.
            place: Links or copies a file of another episode.
        """
        self.info = info
        self._base = base
        self._place = place

    def keep(self, episode: EpisodeRecord, *, episode_id: str | None = None, **about: Any) -> None:
        """Add an episode with all its rows unchanged.

        Args:
            episode: The episode.
            episode_id: Its new id; None for the same.
            about: Fields of `episode.json` to change.

        Raises:
            CorruptEpisode: Its `episode.json` is damaged.
        """
        name = episode_id or episode.id
        folder = self._new(name)
        files = [STEPS_FILE, FRAMES_FILE] if self.info.has_images else [STEPS_FILE]
        values = episode.about
        for file in files:
            self._place(episode.path / file, folder / file)
        if about or name != episode.id or list(values["sha256"]) != files:
            hashes = {file: values["sha256"][file] for file in files}
            write_file(folder / EPISODE_FILE, sealed({**values, "id": name, "sha256": hashes, **about}))
        else:
            self._place(episode.path / EPISODE_FILE, folder / EPISODE_FILE)
        sync_folder(folder)

    def write(self, episode: EpisodeRecord, rows: pa.Table, *, episode_id: str | None = None, **about: Any) -> None:
        """Add an episode with new rows.

        Args:
            episode: Source of the other fields of `episode.json`.
            rows: The rows, with the columns of `stream_schema`.
            episode_id: Its new id; None for the same.
            about: Fields of `episode.json` to change.
        """
        found = ("length", "content_hash", "sha256", "timing", "schema_version")
        kept = {key: value for key, value in episode.about.items() if key not in found}
        name = episode_id or episode.id
        seal(
            self._new(name),
            self.info,
            [rows],
            {**kept, "id": name, **about},
            timing=_same_writer(episode),
        )

    def _new(self, episode_id: str) -> Path:
        check_episode_id(episode_id)
        folder = episode_folder(self._base, episode_id)
        if folder.exists():
            raise InvalidSetup(f"The id {episode_id!r} is given to two episodes; choose different ids.")
        folder.mkdir()
        return folder


def _same_writer(episode: EpisodeRecord) -> Callable[[], Mapping[str, Any]]:
    """Return the entries of the timing report that cannot be computed from the rows."""
    kept = {key: value for key, value in episode.timing.items() if key in ("writer", "is_torn")}
    return lambda: kept


class Transaction(EpisodeFolder):
    """A new generation of a dataset; made by `editing`."""

    def __init__(self, dataset: Dataset, info: DatasetInfo, generation: int) -> None:
        """Start with no episodes; use `editing`."""
        super().__init__(generation_folder(dataset.path, generation), info, link_file)
        self.dataset = dataset
        self.generation = generation


@contextlib.contextmanager
def editing(
    path: str | Path,
    command: str,
    arguments: Mapping[str, Any],
    *,
    new_info: Callable[[DatasetInfo], DatasetInfo] = lambda info: info,
) -> Generator[Transaction]:
    """Edit a dataset: the block fills a new generation, which becomes current at its end.

    Args:
        path: The dataset's folder.
        command: The edit, for the history.
        arguments: Its arguments, for the history, as JSON values.
        new_info: Returns the info after the edit, given that before.

    Raises:
        DatasetError: There is no dataset, another process writes to it, an episode of a killed recording is still open,
            or the disk fails. An error leaves the dataset unchanged.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    read_head(root)  # before a lock is created
    with DatasetLock.writer(root):
        dataset = Dataset.open(root)
        head = dataset.head
        if still_open := open_ids(generation_folder(root, head.generation)):
            raise DatasetError(f"Episodes {still_open} of {root} were left open by a recording; run recover first.")
        with disk_errors(command, root):
            for folder in unreachable_generations(root, head):
                remove_tree(folder)
            known = {head.generation, *generations(root), *(edit.after for edit in head.history)}
            generation = max(known) + 1
            base = generation_folder(root, generation)
            transaction = Transaction(dataset, new_info(head.info), generation)
            try:
                episodes_folder(base).mkdir(parents=True)
                yield transaction
                _commit(transaction, head, command, dict(arguments))
            except BaseException:
                if read_head(root).generation != generation:
                    shutil.rmtree(base, ignore_errors=True)
                raise


def _commit(transaction: Transaction, head: Head, command: str, arguments: dict[str, Any]) -> None:
    root = transaction.dataset.path
    base = generation_folder(root, transaction.generation)
    for folder in (episodes_folder(base), base, base.parent):
        sync_folder(folder)
    edit = Edit(
        command=command,
        arguments=arguments,
        at=now(),
        before=head.generation,
        after=transaction.generation,
        episodes=tuple(complete_ids(base)),
        info=head.info.to_json(),
    )
    write_head(root, Head(info=transaction.info, generation=transaction.generation, history=(*head.history, edit)))


@contextlib.contextmanager
def making(out: str | Path, info: DatasetInfo) -> Generator[EpisodeFolder]:
    """Make a dataset of episodes of others: the block fills it, and it appears at its end.

    Args:
        out: Its folder; nothing may be there.
        info: What its episodes share.

    Raises:
        DatasetError: The folder is not empty, or the disk fails; then nothing is left behind.
    """
    with new_output(out) as partial:
        episodes_folder(partial).mkdir(parents=True)
        yield EpisodeFolder(partial, replace(info), copy_file)
        write_head(partial, Head(info=info))
        for folder in (episodes_folder(partial), partial):
            sync_folder(folder)


def now() -> str:
    """Return the wall clock in the format of the history."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")
