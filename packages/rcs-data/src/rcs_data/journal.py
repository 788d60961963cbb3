"""`episodes.jsonl`: the index of a dataset, told as what happened to it, line by line.

The first line has what the episodes share; each later one adds a recorded episode, or is an edit with the differences
that it makes, or undoes one. What the dataset is now is the sum of its lines. Appending a line is the one step in which
anything takes effect; a line that a kill has cut short counts as not written. Each line ends with its CRC-32.

Several processes may append at a time: they take turns by a lock on the file.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rcs_data.durable import sync, sync_folder, write_all, write_file
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.index import Changes, Edit, Entry, State
from rcs_data.info import DatasetInfo
from rcs_data.json_file import parsed_json
from rcs_data.layout import JOURNAL_FILE, check_path
from rcs_data.lock import with_reserve
from rcs_data.text import check_texts, is_storable

_LONGEST_FILE = 1 << 31


class Journal:
    """The journal of a dataset on disk; `state` is brought up to date by `refresh` and by every addition."""

    def __init__(self, root: Path, *, is_whole: bool = True) -> None:
        """Read it.

        Args:
            root: The dataset's folder.
            is_whole: Whether all lines are read; otherwise the first, which tells that there is a dataset.

        Raises:
            DatasetError: There is no dataset, its layout is of another version, or its path is not UTF-8.
            CorruptEpisode: A line is damaged; `rcs-data check --repair` leaves it out.
        """
        check_path(root)
        self.root = root
        self.path = root / JOURNAL_FILE
        self._end = 0
        self._count = 0
        lines = self._lines(most=None if is_whole else 1)
        self.state = self._first(lines)
        self._take(lines)

    @classmethod
    def create(cls, root: Path, info: DatasetInfo) -> Journal:
        """Write the journal of a new dataset, in one step.

        Raises:
            OSError: The disk fails.
        """
        write_file(root / JOURNAL_FILE, line_of({"dataset": info.to_json()}))
        sync_folder(root)
        return cls(root)

    def refresh(self) -> State:
        """Take the lines that were appended since, and return the state.

        Raises:
            DatasetError: The journal is gone.
            CorruptEpisode: A line is damaged.
        """
        self._take(self._lines())
        return self.state

    def add(self, about: Mapping[str, Any], folder: str) -> None:
        """Add an episode whose folder is complete, given the contents of its `episode.json`.

        Raises:
            DatasetError: There is an episode of this id.
            OSError: The disk is full or fails.
        """

        def line(state: State) -> dict[str, Any]:
            if about["id"] in state.episodes:
                raise DatasetError(f"There already is an episode {about['id']!r} in {self.root}; choose another id.")
            return {"add": Entry.of(about, folder, state.info).to_json()}

        self._append(line)

    def remove(self, episode_id: str) -> Entry:
        """Take an episode out for good, and return what it was.

        Raises:
            DatasetError: There is no such episode.
            OSError: The disk is full or fails.
        """
        entry = self.refresh().episodes.get(episode_id)

        def line(state: State) -> dict[str, Any]:
            if episode_id not in state.episodes:
                raise DatasetError(f"There is no episode {episode_id!r} in {self.root} to remove.")
            return {"remove": episode_id}

        self._append(line)
        assert entry is not None
        return entry

    def edit(self, command: str, arguments: Mapping[str, Any], changes: Changes) -> None:
        """Make an edit; command and arguments, which are JSON values, are for the history.

        Raises:
            OSError: The disk is full, also without the dataset's reserve, or fails; nothing has changed.
        """
        what = changes.to_json()
        self._append(lambda state: {"edit": {**_told(state, command, arguments), **what}}, has_reserve=True)

    def undo(self) -> Edit:
        """Undo the last edit that is not undone, and return it.

        Raises:
            DatasetError: There is nothing to undo, or something was recorded since that would not fit.
            OSError: The disk is full or fails.
        """
        edit = self.refresh().undoable()
        if edit is None:
            raise DatasetError(f"There is nothing to undo in {self.root}; what was pruned does not come back.")
        self.state.refuse_undo(self.root)
        told = {"command": edit.command, "at": edit.at}
        self._append(lambda state: {"undo": _told(state, "undo", told)})
        return edit

    def shorten(self) -> None:
        """Write the journal anew, in one step: what the dataset is, and its history without what undo needs.

        Raises:
            OSError: The disk is full or fails; the former journal is there.
        """
        state = self.refresh()
        state.forget()
        with_reserve(self.root, lambda: write_state(self.root, state))
        fresh = Journal(self.root)
        self.state, self._end, self._count = fresh.state, fresh._end, fresh._count

    def _first(self, lines: Iterator[tuple[int, bytes]]) -> State:
        for _, body in lines:
            values = parsed_json(body, self.path)
            if set(values) != {"dataset"} or not isinstance(values["dataset"], dict):
                raise self._damaged(1, "it does not say what the episodes share")
            try:
                return State(DatasetInfo.from_json(values["dataset"]))
            except InvalidSetup as err:
                raise self._damaged(1, str(err)) from err
        raise self._damaged(1, "it is not there")

    def _take(self, lines: Iterator[tuple[int, bytes]]) -> None:
        for number, body in lines:
            try:
                self.state.take(parsed_json(body, self.path))
            except InvalidSetup as err:
                raise self._damaged(number, str(err)) from err

    def _lines(self, most: int | None = None) -> Iterator[tuple[int, bytes]]:
        """Yield the number and the text of each whole line from where the last reading ended."""
        try:
            if self.path.exists() and not self.path.is_file():  # reading a pipe would never end
                raise self._damaged(1, "it is not a file")
            with self.path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                if size > _LONGEST_FILE:
                    raise self._damaged(1, f"the file has {size} bytes, more than any index")
                file.seek(self._end)
                data = file.readline() if most else file.read(max(size - self._end, 0))
        except FileNotFoundError:
            raise DatasetError(f"There is no dataset in {self.root}: {JOURNAL_FILE} is missing.") from None
        except OSError as err:
            raise DatasetError(f"Cannot read {self.path}: {err.strerror or err}.") from err
        for line in data.split(b"\n")[:-1]:  # after the last line break comes nothing, or what a kill cut short
            body = checked_line(line)
            if body is None:
                raise self._damaged(self._count + 1, "its checksum does not match")
            self._end += len(line) + 1
            self._count += 1
            yield self._count, body

    def _append(self, make: Callable[[State], dict[str, Any]], *, has_reserve: bool = False) -> None:
        """Append a line made of the newest state, when it is this process's turn.

        A recording has no reserve: with a disk that it has filled, episodes are still to be deleted.
        """
        with self._turn() as fd:
            self.refresh()
            line = line_of(make(self.state))

            def write() -> None:
                os.ftruncate(fd, self._end)  # a killed writer may have left half a line
                os.lseek(fd, self._end, os.SEEK_SET)
                try:
                    write_all(fd, line)
                    sync(fd)
                except BaseException:
                    os.ftruncate(fd, self._end)
                    raise

            with_reserve(self.root, write) if has_reserve else write()
            self.refresh()

    @contextlib.contextmanager
    def _turn(self) -> Generator[int]:
        """Wait until no other process appends, and yield the open file, which has no other name."""
        while True:
            # Not through a link, since its target may be the index of another dataset.
            fd = os.open(self.path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX)
                found = os.fstat(fd)
                if not os.path.samestat(found, self.path.lstat()):  # replaced in between
                    continue
                if found.st_nlink == 1:
                    yield fd
                    return
                write_file(self.path, self.path.read_bytes())  # a snapshot by hard links stays as it is
                sync_folder(self.root)
            finally:
                os.close(fd)

    def _damaged(self, number: int, why: str) -> CorruptEpisode:
        return CorruptEpisode(
            f"{self.path} is damaged in line {number}: {why}. `rcs-data check --repair` leaves the line out."
        )


def line_of(values: Mapping[str, Any]) -> bytes:
    """Return a line of the journal, with its checksum and line break.

    Raises:
        InvalidSetup: A text cannot be stored.
    """
    text = json.dumps(values, separators=(",", ":"), ensure_ascii=False)
    if not is_storable(text):
        check_texts(dict(values), "what is to be stored")
    body = text.encode()
    return b"%b\t%08x\n" % (body, zlib.crc32(body))


def checked_line(line: bytes) -> bytes | None:
    """Return the text of a line; None if its checksum does not match."""
    body, _, checksum = line.rpartition(b"\t")
    return body if checksum == b"%08x" % zlib.crc32(body) else None


def write_state(root: Path, state: State) -> None:
    """Write a journal that comes to a state, in one step, without what undo needs.

    Raises:
        OSError: The disk is full or fails.
    """
    lines = [line_of({"dataset": state.info.to_json()})]
    lines += [line_of({"add": entry.to_json()}) for entry in state.episodes.values()]
    lines += [line_of({"past": vars(edit)}) for edit in state.history]
    lines += [line_of({"gone": [folder, content_hash]}) for folder, content_hash in state.removed.items()]
    write_file(root / JOURNAL_FILE, b"".join(lines))
    sync_folder(root)


def now() -> str:
    """Return the wall clock in the format of the history."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def _told(state: State, command: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    return {"number": state.last_number + 1, "command": command, "arguments": dict(arguments), "at": now()}
