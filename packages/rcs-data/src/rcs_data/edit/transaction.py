"""Transactions: an edit of a dataset takes effect only when complete.

The folder of an episode never changes. An edit writes new folders for the episodes whose rows change, and a new index,
which names them (`rcs_data.index.history`). Until that is decided, nothing reads them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.errors import DatasetError
from rcs_data.files.about import read_about
from rcs_data.files.durable import disk_errors, remove_tree
from rcs_data.files.info import DatasetInfo
from rcs_data.files.layout import (
    EPISODE_FILE,
    EPISODES_FOLDER,
    FORMER_FOLDER,
    OPEN_FOLDER,
    folder_names,
    trash,
    written_folder,
)
from rcs_data.files.output import OnProgress
from rcs_data.index import history
from rcs_data.index.entry import Entry
from rcs_data.index.history import Draft, Edit, locked
from rcs_data.index.index import Index
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.record.copies import rewrite
from rcs_data.record.recover import unlisted


class Transaction:
    """An edit that is being prepared; made by `editing`."""

    def __init__(self, info: DatasetInfo, draft: Draft) -> None:
        """Change nothing yet; use `editing`."""
        self.info = info
        self.entries = dict(draft.index.entries)
        """The entries after the edit, by id."""
        self._draft = draft

    @cached_property
    def dataset(self) -> Dataset:
        """The dataset before the edit."""
        index = self._draft.index
        return Dataset(index.root, index)

    def write(self, episode: EpisodeRecord, rows: Iterable[pa.Table]) -> None:
        """Give an episode new rows.

        Args:
            episode: The episode.
            rows: All its rows with the columns of `stream_schema`, in pieces.

        Raises:
            OSError: The disk is full or fails.
        """
        folder = self._draft.folder / EPISODES_FOLDER / written_folder(episode.id, self._draft.number)
        folder.mkdir()
        rewrite(folder, self.info, episode, rows, {})
        self.entries[episode.id] = Entry.of(read_about(folder), folder.name, self.info)

    def write_all(
        self, new_rows: Callable[[EpisodeRecord], Iterable[pa.Table]], on_progress: OnProgress | None
    ) -> None:
        """Give every episode new rows, as `write` does; `on_progress` gets the number of episodes done and of all."""
        episodes = self.dataset.episodes
        for done, episode in enumerate(episodes, 1):
            self.write(episode, new_rows(episode))
            if on_progress is not None:
                on_progress(done, len(episodes))


@contextlib.contextmanager
def editing(
    path: str | Path,
    command: str,
    arguments: Mapping[str, Any],
    *,
    new_info: Callable[[DatasetInfo], DatasetInfo] = lambda info: info,
) -> Generator[Transaction]:
    """Edit a dataset: the block says what changes, and the end of the block makes it so.

    Args:
        path: The dataset's folder.
        command: The edit, for the history.
        arguments: Its arguments, for the history, as JSON values.
        new_info: Returns the info after the edit, given that before.

    Raises:
        DatasetError: There is no dataset, another process writes to it, the info changes while an episode of a killed
            recording is still open or not in the index, or the disk fails. An error leaves the dataset unchanged.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    with locked(root) as index, disk_errors(command, root):
        info = new_info(index.info)
        if info != index.info:
            _refuse_open(index)
        draft = Draft(index)
        try:
            transaction = Transaction(info, draft)
            yield transaction
            draft.decide(command, arguments, transaction.entries, info)
        finally:
            draft.drop()


def undo(path: str | Path) -> Edit:
    """Undo the last edit that is not undone yet, and return it.

    Args:
        path: The dataset.

    Raises:
        DatasetError: There is nothing to undo, the former episodes are gone, episodes were added or removed since, an
            episode of a killed recording is still open or not in the index, or another process writes to the dataset;
            nothing changes.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    with locked(root) as index, disk_errors("undo", root):
        _refuse_open(index)
        return history.undo(index)


def prune(path: str | Path) -> int:
    """Remove former episodes for good, and return the bytes freed; the history stays, but cannot be undone.

    It needs no space, so that a full disk is no obstacle.

    Args:
        path: The dataset.

    Raises:
        DatasetError: Another process writes to the dataset, or the disk fails.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    with locked(root), disk_errors("prune", root):
        for name in folder_names(root, FORMER_FOLDER):  # a kill leaves all of it or none under its name
            (root / FORMER_FOLDER / name).rename(root / FORMER_FOLDER / f".{name}")
        folders = trash(root)
        freed = sum(map(_freed, folders))
        for folder in folders:
            remove_tree(folder)
        history.forget(root)
    return freed


def _refuse_open(index: Index) -> None:
    """Refuse if recover would add an episode, whose rows have the former form: an open one, or one without its line."""
    finished = (folder.name for folder in unlisted(index) if (folder / EPISODE_FILE).exists())
    left = [*folder_names(index.root, OPEN_FOLDER), *finished]
    if left:
        raise DatasetError(
            f"Episodes {', '.join(left[:5])} of {index.root} were left by a recording; run recover first, or "
            "`check --repair` for those that it leaves alone."
        )


def _freed(folder: Path) -> int:
    """Return the bytes of the files in a folder that no other folder links to."""
    found = [file.stat() for file in folder.rglob("*") if file.is_file()]
    return sum(one.st_size for one in found if one.st_nlink == 1)
