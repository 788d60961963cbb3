"""Edits: each takes effect in one step, is listed in the history, and can be undone.

An edit is prepared in a folder of its own, laid out like the dataset: new folders of episodes, the new index, a new
`dataset.json`, and `history/N.jsonl`, which has what was done, and the index before. One rename decides it. More
renames follow, which bring everything into its place; whoever comes after a kill finishes them, and until then readers
take what is decided from where it is.
"""

from __future__ import annotations

import contextlib
import io
import os
import zlib
from collections.abc import Generator, Iterable, Iterator, Mapping
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.durable import remove_tree, sealed, sync_folder, write_file
from rcs_data.files.info import DatasetInfo
from rcs_data.files.json_file import read_bytes
from rcs_data.files.layout import (
    DATASET_FILE,
    DRAFT_FOLDER,
    EDIT_FOLDER,
    EPISODES_FOLDER,
    FORMER_FOLDER,
    HISTORY_FOLDER,
    INDEX_FILE,
    edit_number,
    folder_names,
    has_dataset,
)
from rcs_data.files.lock import DatasetLock, with_reserve
from rcs_data.index.entry import Entry, entry_of, sealed_line, unsealed
from rcs_data.index.index import Index

UNDO, RELABEL = "undo", "relabel"
_FOLDERS = (EPISODES_FOLDER, FORMER_FOLDER, HISTORY_FOLDER)


class Edit(msgspec.Struct, frozen=True, kw_only=True):
    """The first line of a file of the history: what was done."""

    number: int
    """The number of the edit, from 1; what it wrote has the number in its folder's name."""
    command: str
    """The command that made the edit, such as "delete" or "undo"."""
    arguments: dict[str, Any]
    """Its arguments, as JSON values."""
    at: str
    """Wall clock, ISO 8601 in UTC."""
    episodes: int
    """Number of episodes after it."""
    before: int
    """Number of episodes before it: so many lines follow, until they are pruned."""
    index: int
    """CRC-32 of the index after it, by which an undo sees that nothing was added since."""
    dataset: dict[str, Any] | None
    """The facts that the episodes shared before, if the edit changed them."""


_DECODER = msgspec.json.Decoder(Edit)


def history(root: Path) -> list[Edit]:
    """Return the edits of a dataset, oldest first.

    Raises:
        CorruptEpisode: The first line of a file is damaged.
    """
    return [_edit_in(path) for path in _files(root)]


def edits_in_force(root: Path) -> list[Edit]:
    """Return the edits that are not undone, oldest first.

    Raises:
        CorruptEpisode: The first line of a file is damaged.
    """
    left: list[Edit] = []
    for edit in history(root):
        if edit.command == UNDO:  # by its number: the file of what it undid may be in quarantine
            left = [one for one in left if one.number != edit.arguments.get("number")]
        else:
            left.append(edit)
    return left


def relabelled(about: Mapping[str, Any], folder: str, edits: Iterable[Edit]) -> dict[str, Any]:
    """Return the contents of an `episode.json` with the instruction that edits gave the episode later.

    Args:
        about: The contents; the folder of an episode never changes.
        folder: The folder's name.
        edits: Those in force, oldest first.
    """
    found, written, recorded = dict(about), edit_number(folder), about["ended"] or about["started"] or ""
    for edit in edits:
        ids = edit.arguments.get("episodes")
        is_later = edit.number > written if written else edit.at > recorded
        if edit.command == RELABEL and is_later and (ids is None or about["id"] in ids):
            found["instruction"] = edit.arguments["instruction"]
    return found


@contextlib.contextmanager
def locked(root: Path) -> Generator[Index]:
    """Hold a dataset as its only writer, and yield its index.

    Raises:
        DatasetError: There is no dataset, or another process writes to it.
        CorruptEpisode: The index is damaged.
    """
    if not has_dataset(root):
        Index(root)  # which says so, before a lock is created
    with DatasetLock.writer(root):
        finish_edit(root)
        yield Index(root)


class Draft:
    """An edit in preparation."""

    def __init__(self, index: Index) -> None:
        """Start with nothing changed; what a killed edit has left is removed."""
        self.index = index
        root = index.root
        # The folders have the number of an edit even if its file is in quarantine.
        names = (*folder_names(root), *folder_names(root, FORMER_FOLDER))
        self.number = max((*(int(path.stem) for path in _files(root)), *map(edit_number, names)), default=0) + 1
        self.folder = root / DRAFT_FOLDER

        def make() -> None:
            remove_tree(self.folder)
            for name in (EPISODES_FOLDER, HISTORY_FOLDER):
                (self.folder / name).mkdir(parents=True)

        with_reserve(root, make)

    def decide(
        self, command: str, arguments: Mapping[str, Any], entries: Mapping[str, Entry], info: DatasetInfo
    ) -> None:
        """Make the edit.

        Args:
            command: Name of the command, for the history.
            arguments: Its arguments, as JSON values.
            entries: The entries after it, by id.
            info: The facts that the episodes share after it.

        Raises:
            OSError: The disk is full, also without the dataset's reserve, or fails; nothing has changed.
            DatasetError: The edit is made, and its files could not be brought into their places.
        """
        index, root = self.index, self.index.root
        data = b"".join(entry.line for entry in entries.values())
        is_same = info == index.info
        edit = Edit(
            number=self.number,
            command=command,
            arguments=dict(arguments),
            at=datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
            episodes=len(entries),
            before=len(index.entries),
            index=zlib.crc32(data),
            dataset=None if is_same else index.info.to_json(),
        )

        def write() -> None:
            for name in _FOLDERS:  # before the disk is too full for them
                (root / name).mkdir(exist_ok=True)
            before = read_bytes(root / INDEX_FILE)
            whole = memoryview(before)[: before.rfind(b"\n") + 1]
            write_file(self.folder / HISTORY_FOLDER / f"{edit.number}.jsonl", sealed_line(edit), whole)
            if not is_same:
                for folder in (self.folder, self.folder / HISTORY_FOLDER):
                    write_file(folder / DATASET_FILE, sealed(info.to_json()))
            write_file(self.folder / INDEX_FILE, data)

        with_reserve(root, write)
        for folder in (*(self.folder / name for name in (EPISODES_FOLDER, HISTORY_FOLDER)), self.folder):
            sync_folder(folder)
        self.folder.rename(root / EDIT_FOLDER)
        gone = {entry.folder for entry in index.entries.values()} - {entry.folder for entry in entries.values()}
        try:
            sync_folder(root)
            _put_in_place(root, gone, (entry.folder for entry in entries.values()))
        except OSError as err:
            raise DatasetError(
                f"{command!r} is done, but not all its files are in their places in {root}: {err.strerror or err}. "
                "The next program that writes brings them there; do not repeat it."
            ) from err

    def drop(self) -> None:
        """Remove what was prepared, unless it is decided."""
        with contextlib.suppress(OSError):
            remove_tree(self.folder)


def finish_edit(root: Path) -> bool:
    """Bring the files of an edit that was killed after its decision into their places; return whether there was one.

    Raises:
        OSError: The disk fails.
        CorruptEpisode: The index is damaged.
    """
    if not (root / EDIT_FOLDER).is_dir():
        return False
    kept = {entry.folder for entry in Index(root).entries.values()}
    gone: set[str] = set()
    for path in (root / EDIT_FOLDER / HISTORY_FOLDER).glob("*.jsonl"):
        gone = {entry.folder for entry in _entries_in(path)} - kept
    for name in _FOLDERS:
        (root / name).mkdir(exist_ok=True)
    _put_in_place(root, gone, kept)
    return True


def undo(index: Index) -> Edit:
    """Undo the last edit that is not undone, and return it.

    Raises:
        DatasetError: There is nothing to undo, something was recorded since, or former episodes are gone.
        CorruptEpisode: The former index is damaged.
        OSError: The disk is full or fails.
    """
    root, edits = index.root, edits_in_force(index.root)
    if not edits:
        raise DatasetError(f"There is nothing to undo in {root}.")
    edit = edits[-1]
    path = root / HISTORY_FOLDER / f"{edit.number}.jsonl"
    entries = {entry.id: entry for entry in _entries_in(path)}
    if len(entries) < edit.before:
        raise DatasetError(f"Cannot undo {edit.command!r} in {root}: its former episodes were pruned.")
    if zlib.crc32(read_bytes(root / INDEX_FILE)) != edit.index:
        raise DatasetError(
            f"Episodes were added to {root}, or removed, since {edit.command!r}, which undo would lose. An edit "
            "can be undone until then; now delete or relabel what you do not want."
        )
    there = {*folder_names(root), *folder_names(root, FORMER_FOLDER)}
    if gone := [name for name, entry in entries.items() if entry.folder not in there]:
        raise DatasetError(
            f"Cannot undo {edit.command!r}: episodes {', '.join(gone[:5])} of {root} are in quarantine, or removed."
        )
    info = index.info if edit.dataset is None else DatasetInfo.from_json(edit.dataset)
    draft = Draft(index)
    try:
        draft.decide(UNDO, {"command": edit.command, "at": edit.at, "number": edit.number}, entries, info)
    finally:
        draft.drop()
    return edit


def forget(root: Path) -> None:
    """Give up the former indexes; what was done stays listed.

    Raises:
        OSError: The disk is full, also without the dataset's reserve, or fails.
    """
    for path in _files(root):
        with path.open("rb") as file:
            line = file.readline()
        if path.stat().st_size > len(line):
            with_reserve(root, partial(write_file, path, line))  # a snapshot by hard links stays as it is


def _put_in_place(root: Path, gone: Iterable[str], kept: Iterable[str]) -> None:
    """Bring the files of a decided edit into their places; twice is harmless."""
    decided, episodes, former = (root / name for name in (EDIT_FOLDER, EPISODES_FOLDER, FORMER_FOLDER))
    there = set(os.listdir(episodes))
    # An edit of many episodes moves as many folders: their paths are texts, and no folder is looked for by itself.
    for name in there.intersection(gone):
        os.rename(f"{episodes}/{name}", f"{former}/{name}")
    missing = set(kept) - there
    for place in (decided / EPISODES_FOLDER, former):
        found = os.listdir(place) if place.is_dir() else ()  # a kill may have come while it was removed
        for name in missing.intersection(found):  # others are in quarantine
            os.rename(f"{place}/{name}", f"{episodes}/{name}")
            missing.remove(name)
    sync_folder(former)
    sync_folder(episodes)
    for folder in (HISTORY_FOLDER, ""):
        for path in sorted((decided / folder).glob("*.json*")):  # the index last
            path.rename(root / folder / path.name)
        sync_folder(root / folder)
    remove_tree(decided)
    sync_folder(root)


def _files(root: Path) -> list[Path]:
    found = [path for path in (root / HISTORY_FOLDER).glob("*.jsonl") if path.stem.isdecimal()]
    return sorted(found, key=lambda path: int(path.stem))


def _edit_in(path: Path) -> Edit:
    with path.open("rb") as file:
        line = file.readline().rstrip(b"\n")
    try:
        return unsealed(line, _DECODER)
    except ValueError as err:
        raise CorruptEpisode(
            f"{path} is damaged: its first line is not what was written; `rcs-data check --repair` removes it."
        ) from err


def _entries_in(path: Path) -> list[Entry]:
    data = read_bytes(path)
    if data[-1:] != b"\n":
        raise CorruptEpisode(f"{path} is damaged: its last line is cut short.")
    lines = enumerate(io.BytesIO(data), 1)
    next(lines)  # the edit
    return [entry_of(line[:-1], path, number) for number, line in lines]


def damaged_history(root: Path) -> Iterator[tuple[Path, str]]:
    """Yield the files of the history that are damaged, and why."""
    for path in _files(root):
        try:
            if (count := len(_entries_in(path))) not in (0, _edit_in(path).before):
                raise CorruptEpisode(f"{path} is damaged: it has {count} lines after the first.")
        except CorruptEpisode as err:
            yield path, str(err)
