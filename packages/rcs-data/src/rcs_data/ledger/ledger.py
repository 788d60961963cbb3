"""A ledger on disk: a folder to which evaluations append a line per episode that ended.

    evaluation/
      ledger.jsonl              a line per episode, with its checksum; lines are only ever appended
      conditions/<hash>.json    what the episodes of a condition share
      films/<key>.mp4
      report.html

Several processes append at a time: they take turns by a lock on the file. A line that a kill has cut short counts as
not written, and the next writer removes it. A process claims an episode before it runs it, by a lock on a byte of
`.claims` that ends with the process, so that several processes share the episodes of one evaluation.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import hashlib
import json
import os
import zlib
from collections.abc import Generator, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.closing import Closing
from rcs_data.files.durable import append, disk_errors, sealed, sync_folder, unsealed, write_file
from rcs_data.files.json_file import parsed_json, read_bytes
from rcs_data.files.layout import check_path
from rcs_data.ledger.condition import Condition, named
from rcs_data.ledger.row import Row, row_of

LEDGER_FILE = "ledger.jsonl"
CONDITIONS_FOLDER = "conditions"
FILMS_FOLDER = "films"
_CLAIMS_FILE = ".claims"


class Ledger(Closing):
    """The episodes in a ledger's folder; `refresh` takes in what was appended since."""

    def __init__(self, folder: str | Path) -> None:
        """Read a ledger; nothing is written.

        Args:
            folder: Its folder.

        Raises:
            DatasetError: There is no ledger, or it cannot be read.
        """
        self.folder = Path(folder)
        self.rows: dict[str, Row] = {}
        """The episodes by name: key, and number of the repetition."""
        self.damage: list[str] = []
        """A sentence on each line that is left out, with its number."""
        self._path = self.folder / LEDGER_FILE
        self._end = self._lines = 0
        self._claims: int | None = None
        self._known: dict[str, tuple[Condition, str]] = {}
        self.refresh()

    @classmethod
    def open(cls, folder: str | Path) -> Ledger:
        """Open a ledger to append to it; a folder that is missing or empty becomes one.

        Raises:
            DatasetError: Something else is in the folder, its path is not UTF-8, or the disk fails.
        """
        root = Path(folder)
        check_path(root)
        with disk_errors("make the ledger", root):
            root.mkdir(parents=True, exist_ok=True)
            if not (root / LEDGER_FILE).exists():
                found = sorted(path.name for path in root.iterdir() if path.name != CONDITIONS_FOLDER)
                if found and not (root / LEDGER_FILE).exists():  # another process may have made it meanwhile
                    raise DatasetError(
                        f"{root} is not empty and has no {LEDGER_FILE}, but {found[0]}. Choose another folder for the "
                        "ledger."
                    )
                (root / CONDITIONS_FOLDER).mkdir(exist_ok=True)
                os.close(os.open(root / LEDGER_FILE, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o644))
                sync_folder(root)
        return cls(root)

    def refresh(self) -> dict[str, Row]:
        """Take in the lines that were appended since, and return the rows by name.

        Raises:
            DatasetError: The ledger is gone, or cannot be read.
        """
        if not self._path.is_file():
            raise DatasetError(f"There is no ledger in {self.folder}: {LEDGER_FILE} is missing.")
        with disk_errors("read the ledger", self._path):
            fd = os.open(self._path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                fcntl.flock(fd, fcntl.LOCK_SH)  # nobody is in the middle of a line
                self._take(fd)
            finally:
                os.close(fd)
        return self.rows

    def of(self, condition: str) -> list[Row]:
        """Return the rows of a condition, by its hash, in the order of their ends, without repetitions."""
        return [row for row in self.rows.values() if row.condition == condition and not row.repeat]

    def add(self, row: Row) -> bool:
        """Append an episode; return False, and leave everything as it is, if it is there already.

        One whose answer was taken back is appended again, with more `corrections`, and takes the place of the line
        before.

        Raises:
            DatasetError: The disk is full or fails.
            InvalidSetup: A text cannot be stored.
        """
        line = row.line
        with disk_errors("write an episode", self._path), self._turn() as fd:
            self._take(fd)
            if self._is_known(row):
                return False
            append(fd, self._end, line)
            self._take(fd)
        return True

    def claim(self, key: str, repeat: int = 0) -> bool:
        """Return whether an episode is neither there nor running elsewhere; it is then this process's own.

        Args:
            key: Its key.
            repeat: The number of the repetition.

        Raises:
            DatasetError: The ledger cannot be read.
        """
        name = named(key, repeat)
        with disk_errors("claim an episode", self.folder):
            if self._claims is None:
                self._claims = os.open(self.folder / _CLAIMS_FILE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
            try:
                fcntl.lockf(self._claims, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(name))
            except (BlockingIOError, PermissionError):
                return False
        if name not in self.refresh():
            return True
        fcntl.lockf(self._claims, fcntl.LOCK_UN, 1, _place(name))
        return False

    def register(self, condition: Condition, place: str = "", *, hidden: tuple[Condition, str] | None = None) -> str:
        """Describe a condition, and return its hash; one that is described stays as it is.

        Args:
            condition: The condition that its episodes share.
            place: Where its agent comes from: an address, or the path of a checkpoint.
            hidden: In a blind comparison, the true condition and place, which are there in a form that nobody reads by
                accident until `unblind`.

        Raises:
            DatasetError: The disk fails.
        """
        values: dict[str, Any] = {"place": place, "condition": condition.to_json()}
        if hidden is not None:
            values["hidden"] = _unreadable({"condition": hidden[0].to_json(), "place": hidden[1]})
        if not self._description(condition.hash).exists():
            self._describe(condition.hash, values)
        return condition.hash

    def blind(self) -> list[tuple[Condition, Condition]]:
        """Return the conditions of blind comparisons that are not revealed yet, as they are named and as they are.

        Raises:
            CorruptEpisode: A description is damaged.
        """
        return [(blind, true) for _, blind, true, _ in self._hidden()]

    def unblind(self) -> list[tuple[Condition, Condition]]:
        """Reveal the conditions of blind comparisons, and return them as they were named and as they are.

        Raises:
            CorruptEpisode: A description is damaged.
            DatasetError: The disk fails.
        """
        found = self._hidden()
        for values, blind, true, place in found:
            kept = {name: value for name, value in values.items() if name != "hidden"}
            self._describe(blind.hash, {**kept, "revealed": {"condition": true.to_json(), "place": place}})
        self._known.clear()
        return [(blind, true) for _, blind, true, _ in found]

    def condition(self, hash_: str) -> Condition:
        """Return what the episodes of a condition share.

        Raises:
            CorruptEpisode: Its description is missing or damaged.
        """
        return self._described(hash_)[0]

    def place(self, hash_: str) -> str:
        """Return where the agent of a condition is from; raises as `condition` does."""
        return self._described(hash_)[1]

    @property
    def conditions(self) -> dict[str, Condition]:
        """The conditions of all rows, by hash, in the order of their first rows; raises as `condition` does."""
        return {hash_: self.condition(hash_) for hash_ in dict.fromkeys(row.condition for row in self.rows.values())}

    def find(self, name: str, besides: str = "") -> str:
        """Return the hash of the condition that has rows and is meant by an agent's name or the start of the hash.

        Args:
            name: The name, or the start of the hash.
            besides: Hash of a condition that is meant only if no other one is.

        Raises:
            InvalidSetup: None is meant, or several; the message has them all, and how they differ.
        """
        known = self.conditions
        found = [one for one in known if one == name] or [one for one in known if known[one].agent == name]
        found = found or [one for one in known if len(name) >= 4 and one.startswith(name)]
        found = [one for one in found if one != besides] or found
        if len(found) == 1:
            return found[0]
        if not found:
            raise InvalidSetup(f"No agent in {self.folder} is {name!r}. There are: {_listed(known.items())}.")
        first = known[found[0]]
        fields = {field for one in found[1:] for field in first.differences(known[one])}
        raise InvalidSetup(
            f"{name!r} is the name of {len(found)} conditions, which differ in {', '.join(sorted(fields))}. Give the "
            f"start of a hash: {_listed((one, known[one]) for one in found)}."
        )

    def film(self, row: Row) -> Path:
        """Return where the film of an episode is, or would be."""
        return self.folder / FILMS_FOLDER / f"{row.name}.mp4"

    def close(self) -> None:
        """Give up what was claimed. Closing twice is harmless."""
        if self._claims is not None:
            os.close(self._claims)
            self._claims = None

    def _take(self, fd: int) -> None:
        """Take in what is in the open file from the last whole line on."""
        size = os.fstat(fd).st_size
        if size < self._end:  # somebody put another file there
            self._end = self._lines = 0
            self.rows.clear()
        self.damage = [one for one in self.damage if not one.endswith(_CUT)] if self._end else []
        *lines, rest = os.pread(fd, size - self._end, self._end).split(b"\n")
        for line in lines:
            self._lines += 1
            self._end += len(line) + 1
            try:
                row = row_of(line, self._path, self._lines)
            except CorruptEpisode as err:
                self.damage.append(str(err))
            else:
                if not self._is_known(row):
                    self.rows[row.name] = row
        if rest:
            self.damage.append(f"Line {self._lines + 1} of {self._path} is left out: {_CUT}")

    def _is_known(self, row: Row) -> bool:
        known = self.rows.get(row.name)
        return known is not None and row.corrections <= known.corrections

    @contextlib.contextmanager
    def _turn(self) -> Generator[int]:
        """Wait until nobody else writes, and yield the open file."""
        fd = os.open(self._path, os.O_RDWR | os.O_NOFOLLOW)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX)
            yield fd
        finally:
            os.close(fd)

    def _describe(self, hash_: str, values: dict[str, Any]) -> None:
        path = self._description(hash_)
        with disk_errors("describe a condition", path):
            path.parent.mkdir(exist_ok=True)
            draft = path.with_suffix(f".{os.getpid()}")  # several processes may write the same
            write_file(draft, sealed(values))
            draft.replace(path)
            sync_folder(path.parent)

    def _hidden(self) -> list[tuple[dict[str, Any], Condition, Condition, str]]:
        """Return what is described of blind comparisons, with the conditions, and the true place."""
        found: list[tuple[dict[str, Any], Condition, Condition, str]] = []
        for path in sorted((self.folder / CONDITIONS_FOLDER).glob("*.json")):
            values = unsealed(read_bytes(path), path)
            if "hidden" in values:
                true = parsed_json(zlib.decompress(base64.b64decode(values["hidden"])), path)
                blind, own = Condition.from_json(values["condition"]), Condition.from_json(true["condition"])
                found.append((values, blind, own, true["place"]))
        return found

    def _description(self, hash_: str) -> Path:
        return self.folder / CONDITIONS_FOLDER / f"{hash_}.json"

    def _described(self, hash_: str) -> tuple[Condition, str]:
        if hash_ not in self._known:
            path = self._description(hash_)
            values = unsealed(read_bytes(path), path)
            try:
                condition = Condition.from_json(values.get("condition", {}))
            except InvalidSetup as err:
                raise CorruptEpisode(f"{path} is no condition: {err}") from err
            if condition.hash != hash_:
                raise CorruptEpisode(f"{path} describes another condition, {condition.hash}.")
            if (true := values.get("revealed")) is not None:
                # With the tag of the comparison: another one of the same agent is another condition.
                condition, values = replace(Condition.from_json(true["condition"]), tags=condition.tags), true
            self._known[hash_] = condition, str(values.get("place", ""))
        return self._known[hash_]


_CUT = "it is cut short."


def _place(name: str) -> int:
    """Return the byte of the file of claims that stands for an episode."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")


def _unreadable(values: dict[str, Any]) -> str:
    return base64.b64encode(zlib.compress(json.dumps(values).encode())).decode()


def _listed(conditions: Iterable[tuple[str, Condition]]) -> str:
    return ", ".join(f"{one.agent} ({hash_})" for hash_, one in conditions) or "none"
