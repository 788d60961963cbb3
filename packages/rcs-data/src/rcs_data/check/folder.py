"""Checks the folder of a dataset: its index, `dataset.json`, and what killed programs left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rcs_data.about import read_about
from rcs_data.check.report import Finding, counted
from rcs_data.durable import sealed, unsealed
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.index import State
from rcs_data.info import DatasetInfo
from rcs_data.journal import Journal, checked_line
from rcs_data.json_file import parsed_json, read_bytes
from rcs_data.layout import (
    DATASET_FILE,
    JOURNAL_FILE,
    episode_folder,
    episodes_folder,
    folder_names,
    open_folder,
    open_ids,
    strange_names,
    trash_folders,
    unwritable_links,
)
from rcs_data.lock import LOCK_FILES, is_locked
from rcs_data.output import leftovers
from rcs_data.recover import stray_folders
from rcs_data.text import mended_text

# Looks at a folder that changes; more than one in a row are rare, since a look is faster than an edit.
_MOST_LOOKS = 10
_UNPRINTABLE = dict.fromkeys(range(32), "�")


def is_as_written(data: bytes, values: dict[str, Any]) -> bool:
    """Return whether the bytes of sealed JSON are exactly those that its values are written as.

    A changed space, or E instead of e in a number, does not change the values nor their checksum.
    """
    return sealed(values) == data


def check_folder(root: Path) -> tuple[State | None, list[Finding]]:
    """Check the index, `dataset.json` and what lies beside the episodes; return what the index says, as far as it can.

    If a writer changes them meanwhile, they are read again, so that the findings are those of one moment.

    Raises:
        DatasetError: There is no dataset, or its layout is of another version.
    """
    state, findings = None, []
    for _ in range(_MOST_LOOKS):
        before = _stamps(root)
        state, findings = check_index(root)
        if state is not None:
            findings += [*check_leftovers(root, state), *_check_undo(root, state)]
        if not findings or _stamps(root) == before:
            break
    return state, findings


def _stamps(root: Path) -> list[tuple[int, int, int]]:
    """Return what differs once the index has changed, or a writer has come."""
    found: list[tuple[int, int, int]] = []
    for path in (root / JOURNAL_FILE, *(root / name for name in LOCK_FILES)):
        with contextlib.suppress(OSError):
            stat = path.stat()
            found.append((stat.st_ino, stat.st_size, stat.st_mtime_ns))
    return found


def check_index(root: Path) -> tuple[State | None, list[Finding]]:
    """Check the index and `dataset.json`; return what the index says, as far as it can be read.

    Raises:
        DatasetError: There is no dataset, or its layout is of another version.
    """
    findings: list[Finding] = []
    state: State | None = None
    is_written = is_locked(root)  # asked before anything is read
    if (root / JOURNAL_FILE).exists() or not (root / DATASET_FILE).exists():
        try:
            state = Journal(root).state
        except CorruptEpisode as err:
            findings.append(Finding("damage", "altered", None, JOURNAL_FILE, str(err)))
            state = whole_lines(root).state
    else:
        message = "missing; `rcs-data check --repair` makes it anew from the episodes"
        findings.append(Finding("damage", "missing", None, JOURNAL_FILE, message))
    return state, [*findings, *_check_description(root, state, is_written)]


@dataclass
class WholeLines:
    """What the index says without its damaged lines."""

    state: State | None
    """The sum of the others; None if neither the first of them nor `dataset.json` says what the episodes share."""
    damaged: int = 0
    """How many are damaged."""
    folders: set[str] = field(default_factory=set[str])
    """The folders that the others name, also of episodes that are gone since."""


def whole_lines(root: Path) -> WholeLines:
    """Read an index that may be damaged, or missing.

    Raises:
        DatasetError: The layout is of another version.
    """
    found = WholeLines(described(root))
    if not (root / JOURNAL_FILE).exists():
        return found
    for number, line in enumerate(read_bytes(root / JOURNAL_FILE).split(b"\n")[:-1]):
        body = checked_line(line)
        try:
            values = parsed_json(b"" if body is None else body, root / JOURNAL_FILE)
            if number == 0:
                found.state = State(DatasetInfo.from_json(values["dataset"]))
            elif found.state is not None:
                found.state.take(values)
                found.folders |= found.state.folders()
        except (CorruptEpisode, InvalidSetup, KeyError, AttributeError):
            found.damaged += 1
    return found


def described(root: Path) -> State | None:
    """Return the state of a dataset without episodes that `dataset.json` describes; None if it cannot be read."""
    path = root / DATASET_FILE
    try:
        return State(DatasetInfo.from_json(unsealed(read_bytes(path), path)))
    except (CorruptEpisode, InvalidSetup):
        return None


def _check_description(root: Path, state: State | None, is_written: bool) -> Iterator[Finding]:
    path = root / DATASET_FILE
    if not path.exists():
        yield Finding("damage", "missing", None, DATASET_FILE, "missing; `rcs-data check --repair` restores it")
        return
    try:
        data = read_bytes(path)
        values = unsealed(data, path)
    except CorruptEpisode as err:
        yield Finding("damage", "altered", None, DATASET_FILE, str(err))
        return
    if not is_as_written(data, values):
        message = "is readable, but its bytes are not those that were written"
        yield Finding("damage", "altered", None, DATASET_FILE, message)
    elif state is not None and data != sealed(state.info.to_json()) and not is_written:
        message = "not what the index says: an edit was killed; `rcs-data recover` updates it"
        yield Finding("warning", "stale", None, DATASET_FILE, message)


def check_leftovers(root: Path, state: State) -> Iterator[Finding]:
    """Yield what a killed writer or edit left, and whole folders that are missing."""
    folder = episodes_folder(root)
    names = set(folder_names(root))
    if not folder.is_dir():
        yield Finding("damage", "missing", None, _in(root, folder), "missing, with all episodes in it")
    for entry in state.episodes.values():
        if entry.folder not in names:
            place = _in(root, episode_folder(root, entry.folder))
            yield Finding("damage", "missing", entry.id, place, "missing, with all files in it")
    for path in unwritable_links(root):
        message = f"a link to {path.readlink()}; it is read, but never written through"
        yield Finding("warning", "link", None, _in(root, path), message)
    yield from check_beside(root)
    if is_locked(root):
        return  # a living writer has open episodes
    for episode_id in open_ids(root):
        place = _in(root, open_folder(root, episode_id))
        yield Finding("warning", "left_open", episode_id, place, "open, and its writer is gone; run recover")
    for name in strange_names(root):
        place = _in(root, folder / mended_text(name).translate(_UNPRINTABLE))
        yield Finding("warning", "stranger", None, place, "its name cannot be an episode's; nothing reads it")
    garbage, unlisted = stray_folders(root, state)
    for path in (*trash_folders(root), *garbage):
        yield Finding("warning", "left_over", None, _in(root, path), "left by a killed program; run recover")
    for path in unlisted:
        message = "complete, and not in the index; run recover"
        try:
            read_about(path)
        except CorruptEpisode as err:
            message = f"not in the index, and cannot be read: {err}"
        except DatasetError as err:
            message = str(err)
        yield Finding("warning", "unlisted", None, _in(root, path), message)


def check_beside(root: Path) -> list[Finding]:
    """Return what killed programs that were to make this folder, or something in its place, left beside it."""
    message = f"beside {root.name}, left by a killed program; `rcs-data check --repair` removes it"
    return [Finding("warning", "left_over", None, path.name, message) for path in leftovers(root)]


def _check_undo(root: Path, state: State) -> Iterator[Finding]:
    """Yield a finding if episodes that undo would bring back are not there any more."""
    if is_locked(root):
        return  # they may just be removed
    gone = [one.id for one in state.returning() if not episode_folder(root, one.folder).exists()]
    edit = state.undoable()
    if gone and edit is not None:
        message = f"{edit.command!r} cannot be undone: {counted(len(gone), 'former episode')} in quarantine or removed"
        yield Finding("warning", "not_undoable", None, JOURNAL_FILE, message)


def _in(root: Path, path: Path) -> str:
    return str(path.relative_to(root))
