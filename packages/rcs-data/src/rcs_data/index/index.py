"""The index of a dataset on disk: `episodes.jsonl`, a line per episode that is there, and `dataset.json`.

Recording appends a line, which is the one step in which an episode becomes part of the dataset; a line that a kill has
cut short counts as not written. Several processes may append at a time: they take turns by a lock on the file. An edit
writes both files anew (`rcs_data.index.history`).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Generator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.durable import append, disk_errors, sealed, sync_folder, unsealed, write_file
from rcs_data.files.info import DatasetInfo
from rcs_data.files.json_file import read_bytes
from rcs_data.files.layout import (
    DATASET_FILE,
    EDIT_FOLDER,
    EPISODES_FOLDER,
    HISTORY_FOLDER,
    INDEX_FILE,
    OPEN_FOLDER,
    check_path,
)
from rcs_data.files.lock import grow_reserve
from rcs_data.index.entry import Entry, entry_of

_MOST_LOOKS = 10
_TAIL = 32


class Index:
    """The contents of a dataset, as its files state them; `refresh` takes in what was appended since."""

    def __init__(self, root: Path) -> None:
        """Read it.

        Args:
            root: The dataset's folder.

        Raises:
            DatasetError: There is no dataset, its layout is of another version, or its path is not UTF-8.
            CorruptEpisode: A line, or `dataset.json`, is damaged; `rcs-data check --repair` mends it.
        """
        check_path(root)
        self.root = root
        self._read()

    @classmethod
    def create(cls, root: Path, info: DatasetInfo, entries: Mapping[str, Entry] | None = None) -> Index:
        """Write the index of a new dataset, or anew; the last step, which makes it a dataset, is one.

        Raises:
            OSError: The disk fails.
        """
        for folder in (root / EPISODES_FOLDER, root / OPEN_FOLDER, root / HISTORY_FOLDER):
            folder.mkdir(parents=True, exist_ok=True)
        write_info(root, info)
        write_file(root / INDEX_FILE, b"".join(entry.line for entry in (entries or {}).values()))
        sync_folder(root)
        return cls(root)

    def refresh(self) -> dict[str, Entry]:
        """Take the lines that were appended since, and return the entries by id.

        Raises:
            DatasetError: The index is gone.
            CorruptEpisode: A line is damaged.
        """
        with self._opened() as file:
            is_same = os.fstat(file).st_ino == self._inode and _before(file, self._end) == self._last
            if is_same:
                self._take(file)
        if not is_same:
            self._read()
        return self.entries

    def add(self, about: Mapping[str, Any], folder: str) -> None:
        """Add an episode whose folder is complete, given the contents of its `episode.json`.

        Raises:
            DatasetError: There is an episode of this id.
            OSError: The disk is full or fails.
        """
        with self._turn() as fd:
            if about["id"] in self.refresh():
                raise DatasetError(f"There already is an episode {about['id']!r} in {self.root}; choose another id.")
            append(fd, self._end, Entry.of(about, folder, self.info).line)
            self.refresh()
        grow_reserve(self.root)

    def remove(self, episode_id: str, before: Callable[[Entry], object] = lambda _: None) -> Entry:
        """Take an episode out for good, and return what it was.

        Args:
            episode_id: The episode.
            before: Called with what it is, just before.

        Raises:
            DatasetError: There is no such episode.
            OSError: The disk is full or fails.
        """
        with self._turn():
            entry = self.refresh().get(episode_id)
            if entry is None:
                raise DatasetError(f"There is no episode {episode_id!r} in {self.root} to remove.")
            before(entry)
            kept = (one.line for one in self.entries.values() if one is not entry)
            write_file(self.root / INDEX_FILE, b"".join(kept))
            sync_folder(self.root)
            self.refresh()
        return entry

    def _read(self) -> None:
        """Read both files, those of an edit that is decided first; again if an edit was made meanwhile."""
        for _ in range(_MOST_LOOKS):
            with self._opened() as file:
                self.info = read_info(self.root)
                self.entries: dict[str, Entry] = {}
                self._end, self._count, self._inode, self._last = 0, 0, os.fstat(file).st_ino, b""
                self._take(file)
                with self._opened() as again:
                    if os.fstat(again).st_ino == self._inode:
                        return
        raise DatasetError(f"{self.root} is edited all the time; read it again.")

    def _take(self, file: int) -> None:
        path = self.root / INDEX_FILE
        with open(file, "rb", closefd=False) as lines:
            lines.seek(self._end)
            for line in lines:
                if line[-1:] != b"\n":  # what a kill cut short
                    break
                entry = entry_of(line[:-1], path, self._count + 1)
                self._end += len(line)
                self._count += 1
                self.entries[entry.id] = entry
        self._last = _before(file, self._end)

    @contextlib.contextmanager
    def _opened(self) -> Generator[int]:
        fd = -1
        with disk_errors("read the index", self.root / INDEX_FILE):
            for _ in range(2):  # it may just move
                decided = self.root / EDIT_FOLDER / INDEX_FILE
                with contextlib.suppress(FileNotFoundError):
                    path = decided if decided.exists() else self.root / INDEX_FILE
                    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
                    break
        if fd < 0:
            raise DatasetError(f"There is no dataset in {self.root}: {INDEX_FILE} is missing.")
        try:
            yield fd
        finally:
            os.close(fd)

    @contextlib.contextmanager
    def _turn(self) -> Generator[int]:
        """Wait until no other process writes, and yield the open file, which has no other name."""
        path = self.root / INDEX_FILE
        while True:
            # Not through a link, since its target may be the index of another dataset.
            fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX)
                found = os.fstat(fd)
                if not os.path.samestat(found, path.lstat()):  # replaced in between
                    continue
                if found.st_nlink == 1:
                    yield fd
                    return
                write_file(path, path.read_bytes())  # a snapshot by hard links stays as it is
                sync_folder(self.root)
            finally:
                os.close(fd)


def read_info(root: Path) -> DatasetInfo:
    """Read what the episodes share: as an edit has it that is decided, or `dataset.json`, or its copy.

    Raises:
        DatasetError: The layout is of another version.
        CorruptEpisode: `dataset.json` is missing or damaged.
    """
    places = (root / EDIT_FOLDER / DATASET_FILE, root / DATASET_FILE, root / HISTORY_FOLDER / DATASET_FILE)
    reasons: list[CorruptEpisode] = []
    for path in places:
        try:
            return info_in(path)
        except CorruptEpisode as err:
            reasons.append(err)
    raise reasons[1]


def info_in(path: Path) -> DatasetInfo:
    """Read a `dataset.json`, or its copy; raises as `read_info` does."""
    try:
        return _info(read_bytes(path), path)
    except (CorruptEpisode, InvalidSetup) as err:
        raise CorruptEpisode(f"{err} `rcs-data check --repair` restores it.") from err


@lru_cache(maxsize=32)  # its checks take ten times as long as reading it
def _info(data: bytes, path: Path) -> DatasetInfo:
    return DatasetInfo.from_json(unsealed(data, path))


def write_info(root: Path, info: DatasetInfo) -> None:
    """Write `dataset.json` and its copy beside the history.

    Raises:
        OSError: The disk fails.
    """
    for folder in (root / HISTORY_FOLDER, root):
        write_file(folder / DATASET_FILE, sealed(info.to_json()))
        sync_folder(folder)


def _before(file: int, end: int) -> bytes:
    """Return what is before a place in the file, which distinguishes one that was written anew from the former."""
    return os.pread(file, min(end, _TAIL), max(end - _TAIL, 0))
