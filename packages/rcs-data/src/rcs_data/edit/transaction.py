"""Transactions: an edit of a dataset, or a new dataset of episodes of others, takes effect only when complete.

The folder of an episode never changes. An edit writes new folders for the episodes whose rows change, and then one line
to the index, which names them. Until then nothing reads them, and the next writer removes what a kill left.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.about import read_about
from rcs_data.compact import seal
from rcs_data.durable import disk_errors, link_file, remove_tree, sealed, sync_folder, write_file
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.index import Changes, Edit, Entry, State
from rcs_data.info import DatasetInfo
from rcs_data.journal import Journal, write_state
from rcs_data.layout import (
    EPISODE_FILE,
    check_episode_id,
    episode_folder,
    episodes_folder,
    new_trash_folder,
    open_ids,
    trash_folders,
    written_folder,
)
from rcs_data.lock import DatasetLock
from rcs_data.output import new_output
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.recover import stray_folders, write_description


class Transaction:
    """An edit that is being prepared; made by `editing`."""

    def __init__(self, dataset: Dataset, info: DatasetInfo, number: int) -> None:
        """Change nothing yet; use `editing`."""
        self.dataset = dataset
        self.info = info
        self._number = number
        self._dropped: set[str] = set()
        self._folders: list[Path] = []
        self._written: dict[str, Entry] = {}
        self._relabelled: tuple[str, ...] | None = ()
        self._instruction: str | None = None

    def drop(self, ids: Iterable[str]) -> None:
        """Leave episodes out."""
        self._dropped |= set(ids)

    def relabel(self, ids: Iterable[str] | None, instruction: str) -> None:
        """Change the instruction of some episodes; None for all, whose instruction is then the dataset's."""
        self._relabelled = None if ids is None else tuple(ids)
        self._instruction = None if ids is None else instruction

    def write(self, episode: EpisodeRecord, rows: Iterable[pa.Table]) -> None:
        """Give an episode new rows.

        Args:
            episode: The episode.
            rows: All its rows with the columns of `stream_schema`, in pieces.

        Raises:
            OSError: The disk is full or fails.
        """
        folder = episode_folder(self.dataset.path, written_folder(episode.id, self._number))
        folder.mkdir()
        self._folders.append(folder)
        self._written[episode.id] = _written(folder, self.info, episode, rows, {})

    def commit(self, journal: Journal, command: str, arguments: Mapping[str, Any]) -> None:
        """Write the line of the edit to the index.

        Raises:
            OSError: The disk is full or fails.
        """
        sync_folder(episodes_folder(self.dataset.path))
        changes = Changes(
            dropped=tuple(sorted(self._dropped)),
            written=tuple(self._written.values()),
            relabelled=self._relabelled,
            instruction=self._instruction,
            info=None if self.info == self.dataset.info else self.info,
        )
        journal.edit(command, arguments, changes)

    def abandon(self, journal: Journal) -> None:
        """Remove what was written, unless the index has it already."""
        if journal.refresh().last_number < self._number:
            for folder in self._folders:
                with contextlib.suppress(OSError):
                    remove_tree(folder)


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
            recording is still open, or the disk fails. An error leaves the dataset unchanged.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    with locked(root) as journal, disk_errors(command, root):
        info = new_info(journal.state.info)
        if info != journal.state.info:  # the rows of open episodes have the former form
            _refuse_open(root)
        for folder in stray_folders(root, journal.state)[0]:
            remove_tree(folder)
        transaction = Transaction(Dataset(root, journal.state), info, journal.state.last_number + 1)
        try:
            yield transaction
            transaction.commit(journal, command, arguments)
        except BaseException:
            transaction.abandon(journal)
            raise
        write_description(root, info)


def _refuse_open(root: Path) -> None:
    if still_open := open_ids(root):
        raise DatasetError(f"Episodes {still_open} of {root} were left open by a recording; run recover first.")


@contextlib.contextmanager
def locked(root: Path) -> Generator[Journal]:
    """Hold a dataset as its only writer, and yield its index.

    Raises:
        DatasetError: There is no dataset, or another process writes to it.
        CorruptEpisode: The index is damaged.
    """
    Journal(root, is_whole=False)  # before a lock is created
    with DatasetLock.writer(root):
        yield Journal(root)


class NewDataset:
    """A dataset that is being made of episodes of others; made by `making`."""

    def __init__(self, root: Path, info: DatasetInfo) -> None:
        """Start with no episodes."""
        self.info = info
        self._root = root
        self._entries: dict[str, Entry] = {}

    def keep(self, episode: EpisodeRecord, *, episode_id: str | None = None, **about: Any) -> None:
        """Add an episode with all its rows unchanged; its files become links to the same bytes.

        Args:
            episode: The episode.
            episode_id: Its new id; None for the same.
            about: Fields of `episode.json` to change.

        Raises:
            CorruptEpisode: Its `episode.json` is damaged.
        """
        name, folder = self._new(episode_id or episode.id)
        stored = read_about(episode.path)
        for file in stored["sha256"]:
            link_file(episode.path / file, folder / file)
        values = {**stored, "id": name, "instruction": episode.instruction, **about}
        if values == stored:
            link_file(episode.path / EPISODE_FILE, folder / EPISODE_FILE)
        else:
            write_file(folder / EPISODE_FILE, sealed(values))
        sync_folder(folder)
        self._entries[name] = Entry.of(values, name, self.info)

    def write(
        self, episode: EpisodeRecord, rows: Iterable[pa.Table], *, episode_id: str | None = None, **about: Any
    ) -> None:
        """Add an episode with new rows.

        Args:
            episode: Source of the other fields of `episode.json`.
            rows: The rows with the columns of `stream_schema`, in pieces.
            episode_id: Its new id; None for the same.
            about: Fields of `episode.json` to change.
        """
        name, folder = self._new(episode_id or episode.id)
        self._entries[name] = _written(folder, self.info, episode, rows, {"id": name, **about})

    def finish(self) -> None:
        """Write the index, without which nothing reads the episodes."""
        write_state(self._root, State(self.info, dict(sorted(self._entries.items()))))
        write_description(self._root, self.info)
        for folder in (episodes_folder(self._root), self._root):
            sync_folder(folder)

    def _new(self, episode_id: str) -> tuple[str, Path]:
        check_episode_id(episode_id)
        if episode_id in self._entries:
            raise InvalidSetup(f"The id {episode_id!r} is given to two episodes; choose different ids.")
        folder = episode_folder(self._root, episode_id)
        folder.mkdir()
        return episode_id, folder


@contextlib.contextmanager
def making(out: str | Path, info: DatasetInfo) -> Generator[NewDataset]:
    """Make a dataset of episodes of others: the block fills it, and it appears at its end.

    Args:
        out: Its folder; nothing may be there.
        info: What its episodes share.

    Raises:
        DatasetError: The folder is not empty, or the disk fails; then nothing is left behind.
    """
    with new_output(out) as partial:
        episodes_folder(partial).mkdir(parents=True)
        made = NewDataset(partial, info)
        yield made
        made.finish()


def undo(path: str | Path) -> Edit:
    """Undo the last edit that is not undone yet, and return it.

    Args:
        path: The dataset.

    Raises:
        DatasetError: There is nothing to undo, the former episodes are gone, what was recorded since does not fit or
            has the ids of what returns, an episode of a killed recording is still open, or another process writes to
            the dataset; nothing changes.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    with locked(root) as journal, disk_errors("undo", root):
        _refuse_open(root)
        gone = [one.id for one in journal.state.returning() if not episode_folder(root, one.folder).exists()]
        if gone:
            edit = journal.state.undoable()
            raise DatasetError(
                f"Cannot undo {edit.command if edit else ''!r}: episodes {', '.join(gone[:5])} of {root} are in "
                "quarantine, or were removed."
            )
        edit = journal.undo()
        write_description(root, journal.state.info)
        for folder in stray_folders(root, journal.state)[0]:
            remove_tree(folder)
    return edit


def prune(path: str | Path) -> int:
    """Remove former episodes for good, and return the bytes freed; the history stays, but cannot be undone.

    Args:
        path: The dataset.

    Raises:
        DatasetError: Another process writes to the dataset, or the disk fails.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    freed = 0
    with locked(root) as journal, disk_errors("prune", root):
        # Removed before the index forgets them, since that needs space; an undo in between is refused.
        for entry in journal.state.former_entries():
            folder = episode_folder(root, entry.folder)
            if os.path.lexists(folder):  # or in quarantine
                folder.rename(new_trash_folder(root, folder.name))
        for folder in (*stray_folders(root, journal.state)[0], *trash_folders(root)):
            freed += _freed(folder)
            remove_tree(folder)
        journal.shorten()
    return freed


def _freed(folder: Path) -> int:
    """Return the bytes of the files in a folder that no other folder links to."""
    found = [file.stat() for file in folder.rglob("*") if file.is_file()]
    return sum(one.st_size for one in found if one.st_nlink == 1)


def _written(
    folder: Path, info: DatasetInfo, episode: EpisodeRecord, rows: Iterable[pa.Table], changes: Mapping[str, Any]
) -> Entry:
    """Write an episode with new rows into a folder, and return its entry."""
    found = ("length", "content_hash", "sha256", "timing", "schema_version")
    kept = {key: value for key, value in episode.about.items() if key not in found}
    # What cannot be computed from the rows.
    measured = {key: value for key, value in episode.timing.items() if key in ("writer", "is_torn")}
    seal(folder, info, rows, {**kept, **changes}, timing=lambda: measured)
    return Entry.of(read_about(folder), folder.name, info)
