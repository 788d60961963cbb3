"""Writes a dataset: creates or resumes it, locks out other writers, and starts episodes."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import checked_about
from rcs_data.files.closing import Closing
from rcs_data.files.durable import HashedFile, disk_errors, remove_folder, sync_folder, unsealed, write_file
from rcs_data.files.info import DatasetInfo, differences
from rcs_data.files.layout import (
    DATASET_FILE,
    EPISODE_FILE,
    EPISODES_FOLDER,
    FRAMES_FILE,
    HISTORY_FOLDER,
    INDEX_FILE,
    OPEN_FOLDER,
    STEPS_FILE,
    check_episode_id,
    check_path,
    folder_names,
    has_dataset,
    new_trash,
    removal_mark,
)
from rcs_data.files.lock import LOCK_FILES, DatasetLock
from rcs_data.index.entry import Entry
from rcs_data.index.history import finish_edit
from rcs_data.index.index import Index
from rcs_data.read.episode_record import EpisodeRecord
from rcs_data.record.compact import publish
from rcs_data.record.copies import link, rewrite
from rcs_data.record.episode_writer import EpisodeWriter, refuse_fork
from rcs_data.record.recover import Leftovers, RecoverReport, settle_leftovers

_log = logging.getLogger(__name__)

Files = Mapping[str, bytes | memoryview]
"""The contents of files by name."""
MOST_DIFFERENCES = 10
"""So many differences of another setup are named; the rest are counted."""


class DatasetWriter(Closing):
    """A dataset that is being recorded; a context manager.

    Several episodes can be open at the same time, for example one per copy of an environment.
    """

    def __init__(self, index: Index, lock: DatasetLock, recovered: RecoverReport) -> None:
        """Hold a dataset; use `open` or `join` to get a writer.

        Args:
            index: The dataset's index.
            lock: The lock that keeps other writers out.
            recovered: Report on the leftovers of an earlier writer.
        """
        self.path = index.root
        self.info = index.info
        self.recovered = recovered
        self._index = index
        self._lock = lock
        self._open: list[EpisodeWriter] = []
        self._is_closed = False
        self._process = os.getpid()
        pa.array(())  # the first array makes pyarrow import pandas, for 0.1 to 0.3 s: not in mid-episode

    @classmethod
    def open(
        cls, path: str | Path, info: DatasetInfo, *, resume: bool = False, leftovers: Leftovers = "recover"
    ) -> DatasetWriter:
        """Create or resume a dataset as its only writer.

        Args:
            path: The folder; created if missing.
            info: The facts that the episodes share.
            resume: Whether to add to an existing dataset instead of refusing it.
            leftovers: Treatment of episodes that were open when an earlier writer died.

        Raises:
            DatasetError: Another process writes to it; it exists and `resume` is not set; its info differs (the message
                lists how); the folder contains something else; the path is not UTF-8; or the disk fails.
            CorruptEpisode: The index is damaged.
        """
        root = Path(path).absolute()
        check_path(root)
        with disk_errors("make the dataset", root):
            root.mkdir(parents=True, exist_ok=True)
            if not has_dataset(root):
                _refuse_strangers(root)
        lock = DatasetLock.writer(root)
        try:
            with disk_errors("make the dataset", root):
                if has_dataset(root):
                    finish_edit(root)
                    index = Index(root)
                    _refuse_other_info(root, index.info, info, resume)
                else:
                    index = Index.create(root, info)
            report = settle_leftovers(index, leftovers)
        except BaseException:
            lock.release()
            raise
        for episode_id, reason in report.failed:
            _log.warning("Open episode %r was left alone: %s", episode_id, reason)
        return cls(index, lock, report)

    @classmethod
    def join(cls, path: str | Path) -> DatasetWriter:
        """Join another process that is writing to the dataset, as its worker; their episodes have different ids.

        Args:
            path: The dataset's folder.

        Raises:
            DatasetError: There is no dataset, or no process is writing to it.
            CorruptEpisode: The index is damaged.
        """
        index = Index(Path(path).absolute())
        return cls(index, DatasetLock.worker(index.root), RecoverReport())

    def episode(self, episode_id: str, *, seed: int | None, instruction: str | None = None) -> EpisodeWriter:
        """Start an episode.

        Args:
            episode_id: Its name; the reader sorts by it.
            seed: The seed that the environment was reset with; None if it was not seeded.
            instruction: The instruction to the robot; None for the dataset's instruction.

        Raises:
            InvalidSetup: The id cannot be the name of a folder.
            DatasetError: An episode has this name, the writer is closed, or the disk fails.
        """
        self._require_open(f"start episode {episode_id!r}")
        words = self.info.instruction if instruction is None else instruction
        writer = EpisodeWriter(self._index, episode_id, seed, words)
        self._open = [other for other in self._open if other.state == "open"]
        self._open.append(writer)
        return writer

    def taken(self) -> set[str]:
        """Return the ids that a new episode cannot have: those of episodes, and of open ones that were left alone.

        Raises:
            CorruptEpisode: The index is damaged.
        """
        return {*self._index.refresh(), *folder_names(self.path, OPEN_FOLDER)}

    def adopt(self, episode_id: str, files: Files) -> None:
        """Take in a complete episode that was recorded into another dataset of the same info, byte for byte.

        A kill leaves an open episode without rows, which the next writer removes, or a complete one.

        Args:
            episode_id: The episode. No writer may be recording it; what a dead one left of it is removed.
            files: The contents of all files of its folder, by name.

        Raises:
            InvalidSetup: The id cannot be the name of a folder.
            CorruptEpisode: The files are not what was written, or not those of this episode of such a dataset.
            DatasetError: An episode has this name, the writer is closed, or the disk fails.
        """
        self._require_open(f"take in episode {episode_id!r}")
        check_episode_id(episode_id)
        expected = {EPISODE_FILE, STEPS_FILE, *([FRAMES_FILE] if self.info.has_images else [])}
        if set(files) != expected:
            raise CorruptEpisode(
                f"Episode {episode_id!r} has the files {', '.join(sorted(files)) or '(none)'}; "
                f"an episode of this dataset has {', '.join(sorted(expected))}."
            )
        folder = self.path / OPEN_FOLDER / episode_id
        description = bytes(files[EPISODE_FILE])
        about = checked_about(unsealed(description, folder / EPISODE_FILE), folder / EPISODE_FILE)
        hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items() if name != EPISODE_FILE}
        if about["id"] != episode_id or about["sha256"] != hashes:
            raise CorruptEpisode(f"Episode {episode_id!r} did not arrive as it was written: an id or a hash differs.")
        if episode_id in self._index.refresh():
            raise DatasetError(
                f"There already is an episode {episode_id!r} in {self.path}; remove it, or choose another id."
            )
        with disk_errors(f"write episode {episode_id!r}", folder):
            if folder.exists():
                remove_folder(folder, new_trash(self.path, episode_id))
            folder.mkdir(parents=True)
            for name in hashes:
                with closing(HashedFile(folder / name)) as file:
                    file.write(files[name])
                    file.complete()
            write_file(folder / EPISODE_FILE, description)
            sync_folder(folder)
        publish(self._index, episode_id)

    def copy(
        self,
        episode: EpisodeRecord,
        rows: Iterable[pa.Table] | None = None,
        *,
        episode_id: str | None = None,
        **about: Any,
    ) -> None:
        """Add an episode of another dataset, with its rows or with others.

        Args:
            episode: The episode.
            rows: Its new rows with the columns of `stream_schema`, in pieces; None for those that it has, whose files
                become links to the same bytes.
            episode_id: Its new id; None for the same.
            about: Fields of `episode.json` to change.

        Raises:
            InvalidSetup: The id cannot be the name of a folder.
            CorruptEpisode: The episode is damaged.
            DatasetError: An episode has this name, the writer is closed, or the disk fails.
        """
        name = episode_id or episode.id
        self._require_open(f"copy episode {name!r}")
        check_episode_id(name)
        folder = self.path / OPEN_FOLDER / name
        with disk_errors(f"copy episode {name!r}", folder):
            folder.mkdir(parents=True)
            changes = {"id": name, **about}
            if rows is None:
                link(folder, self.info, episode, changes)
            else:
                rewrite(folder, self.info, episode, rows, changes)
            publish(self._index, name)

    def remove_episode(self, episode_id: str) -> None:
        """Remove a finished episode for good; what a kill leaves to do, the next writer or `recover` does.

        Args:
            episode_id: The episode.

        Raises:
            DatasetError: There is no such episode, the writer is closed, or the disk fails.
        """
        self._require_open(f"remove episode {episode_id!r}")
        check_episode_id(episode_id)
        with disk_errors(f"remove episode {episode_id!r}", self.path):
            entry = self._index.remove(episode_id, self._mark_removal)
            folder = self.path / EPISODES_FOLDER / entry.folder
            if folder.exists():
                remove_folder(folder, new_trash(self.path, entry.folder))
            removal_mark(self.path, entry.folder).unlink(missing_ok=True)

    def close(self) -> None:
        """Abort the open episodes and give the lock back, whatever fails; calling it twice is harmless.

        In a fork of the process that opened the dataset, nothing is aborted.
        """
        if self._is_closed:
            return
        self._is_closed = True
        if self._process != os.getpid():
            return
        with ExitStack() as last_to_first:
            last_to_first.callback(self._lock.release)
            for episode in self._open:
                if episode.state == "open":
                    last_to_first.callback(episode.end, "its dataset was closed")

    def _mark_removal(self, entry: Entry) -> None:
        """Tell a complete folder that is to go from one whose line a kill has kept from the index."""
        mark = removal_mark(self.path, entry.folder)
        mark.parent.mkdir(exist_ok=True)
        write_file(mark)
        sync_folder(mark.parent)

    def _require_open(self, doing: str) -> None:
        if self._is_closed:
            raise DatasetError(f"Cannot {doing}: the writer of {self.path} is closed.")
        refuse_fork(self._process, doing)


def _refuse_strangers(root: Path) -> None:
    # A kill can leave these of a dataset being created.
    files = {name + end for name in (INDEX_FILE, DATASET_FILE) for end in ("", ".tmp")}
    ours = {*LOCK_FILES, *files, EPISODES_FOLDER, OPEN_FOLDER, HISTORY_FOLDER}
    strangers = sorted(entry.name for entry in root.iterdir() if entry.name not in ours)
    has_episodes = any((root / EPISODES_FOLDER).glob("*"))
    if strangers or has_episodes:
        what = ", ".join(strangers[:5]) or f"episodes and no {INDEX_FILE}; `rcs-data check --repair` makes it anew"
        raise DatasetError(f"{root} is neither a dataset nor empty: it has {what}. Choose another folder.")


def _refuse_other_info(root: Path, stored: DatasetInfo, info: DatasetInfo, resume: bool) -> None:
    lines = differences(stored, info)
    if lines:
        words = [
            *lines[:MOST_DIFFERENCES],
            *([f"and {more} more."] if (more := len(lines) - MOST_DIFFERENCES) > 0 else []),
        ]
        raise DatasetError(
            f"The dataset in {root} was made with another setup; choose another folder. Differences:\n  "
            + "\n  ".join(words)
        )
    if not resume:
        raise DatasetError(f"There already is a dataset in {root}. Resume it (resume=True), or choose another folder.")
