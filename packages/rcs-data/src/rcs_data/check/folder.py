"""Checks the folder of a dataset: its index, `dataset.json`, its history, and what killed programs left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcs_data.check.report import Finding
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import read_about
from rcs_data.files.durable import sealed, unsealed
from rcs_data.files.info import DatasetInfo
from rcs_data.files.json_file import read_bytes
from rcs_data.files.layout import (
    DATASET_FILE,
    EDIT_FOLDER,
    EPISODES_FOLDER,
    HISTORY_FOLDER,
    INDEX_FILE,
    OPEN_FOLDER,
    folder_names,
    has_dataset,
    present_folder,
    removals,
    strange_names,
    trash,
    unwritable_links,
)
from rcs_data.files.lock import is_locked
from rcs_data.files.output import leftovers
from rcs_data.files.text import mended_text
from rcs_data.index.entry import Entry, entry_of
from rcs_data.index.history import damaged_history
from rcs_data.index.index import Index, info_in

# Looks at a folder that changes; more than one in a row are rare, since a look is faster than an edit.
MOST_LOOKS = 10
_UNPRINTABLE = dict.fromkeys(range(32), "�")


@dataclass(frozen=True)
class Contents:
    """The undamaged contents of an index and of `dataset.json`, or its copy."""

    info: DatasetInfo
    entries: dict[str, Entry]


def is_as_written(data: bytes, values: dict[str, Any]) -> bool:
    """Return whether the bytes of sealed JSON are exactly those that its values are written as.

    A changed space, or E instead of e in a number, does not change the values nor their checksum.
    """
    return sealed(values) == data


def check_folder(root: Path) -> tuple[Contents | None, list[Finding]]:
    """Check the index, `dataset.json` and what lies beside the episodes; return what of them is whole.

    If a writer changes them meanwhile, they are read again, so that the findings are those of one moment.

    Raises:
        DatasetError: There is no dataset, or its layout is of another version.
    """
    contents, findings = None, []
    for _ in range(MOST_LOOKS):
        before = stamps(root)
        contents, findings = check_index(root)
        if contents is not None:
            findings += check_leftovers(root, contents)
        if not findings or stamps(root) == before:
            break
    return contents, findings


def stamps(root: Path) -> list[tuple[int, int, int]]:
    """Return what differs once the index has changed, or a writer has come or gone."""
    found = [(int(is_locked(root)), 0, 0)]
    for path in (root / INDEX_FILE, root / EDIT_FOLDER, *(root / name for name in (EPISODES_FOLDER, OPEN_FOLDER))):
        with contextlib.suppress(OSError):
            stat = path.stat()
            found.append((stat.st_ino, stat.st_size, stat.st_mtime_ns))
    return found


def check_index(root: Path) -> tuple[Contents | None, list[Finding]]:
    """Check the index, `dataset.json` and the history; return what of them is whole.

    Raises:
        DatasetError: There is no dataset, or its layout is of another version.
    """
    findings: list[Finding] = []
    copy = root / HISTORY_FOLDER / DATASET_FILE
    if not has_dataset(root):
        if not (root / DATASET_FILE).exists() and not copy.exists():
            Index(root)  # which says that there is none
        message = "missing; `rcs-data check --repair` makes it anew from the episodes"
        findings.append(Finding("damage", "missing", None, INDEX_FILE, message))
    else:
        try:
            index = Index(root)
            contents = Contents(index.info, index.entries)
            return contents, [*_check_infos(root), *_check_history(root)]
        except CorruptEpisode as err:
            if INDEX_FILE in str(err):
                findings.append(Finding("damage", "altered", None, INDEX_FILE, str(err)))
    findings += [*_check_infos(root), *_check_history(root)]
    info = next((found for path in (root / DATASET_FILE, copy) if (found := _readable(path)) is not None), None)
    return (None if info is None else Contents(info, _whole_entries(root))), findings


def _whole_entries(root: Path) -> dict[str, Entry]:
    """Return what the lines of the index that are not damaged say, by id."""
    found: dict[str, Entry] = {}
    path = root / INDEX_FILE
    for number, line in enumerate(read_bytes(path).split(b"\n")[:-1] if path.exists() else [], 1):
        with contextlib.suppress(CorruptEpisode):
            entry = entry_of(line, path, number)
            found[entry.id] = entry
    return found


def _readable(path: Path) -> DatasetInfo | None:
    try:
        return info_in(path)
    except CorruptEpisode:
        return None


def _check_infos(root: Path) -> Iterator[Finding]:
    """Check `dataset.json` and its copy."""
    name = f"{HISTORY_FOLDER}/{DATASET_FILE}"
    for file in (DATASET_FILE, name):
        path = root / file
        try:
            info_in(path)
            data = read_bytes(path)
            values = unsealed(data, path)
        except CorruptEpisode as err:
            yield Finding("damage", "altered" if path.exists() else "missing", None, file, str(err))
            continue
        if not is_as_written(data, values):
            message = "is readable, but its bytes are not those that were written"
            yield Finding("damage", "altered", None, file, message)


def _check_history(root: Path) -> Iterator[Finding]:
    for path, why in damaged_history(root):
        yield Finding("damage", "history", None, str(path.relative_to(root)), why)


def check_leftovers(root: Path, contents: Contents) -> Iterator[Finding]:
    """Yield what a killed writer or edit left, and whole folders that are missing."""
    names = set(folder_names(root))
    if not (root / EPISODES_FOLDER).is_dir():
        yield Finding("damage", "missing", None, EPISODES_FOLDER, "missing, with all episodes in it")
    for entry in contents.entries.values():
        folder = root / EPISODES_FOLDER / entry.folder
        if entry.folder not in names and not present_folder(folder).is_dir():
            yield Finding("damage", "missing", entry.id, _in(root, folder), "missing, with all files in it")
    for path in unwritable_links(root):
        message = f"a link to {path.readlink()}; it is read, but never written through"
        yield Finding("warning", "link", None, _in(root, path), message)
    yield from check_beside(root)
    if is_locked(root):
        return  # a living writer has open episodes
    for episode_id in folder_names(root, OPEN_FOLDER):
        place = _in(root, root / OPEN_FOLDER / episode_id)
        yield Finding("warning", "left_open", episode_id, place, "open, and its writer is gone; run recover")
    for name in strange_names(root):
        place = _in(root, root / EPISODES_FOLDER / mended_text(name).translate(_UNPRINTABLE))
        yield Finding("warning", "stranger", None, place, "its name cannot be an episode's; nothing reads it")
    for path in (*trash(root), *removals(root), *([root / EDIT_FOLDER] if (root / EDIT_FOLDER).exists() else [])):
        yield Finding("warning", "left_over", None, _in(root, path), "left by a killed program; run recover")
    for name in names - {entry.folder for entry in contents.entries.values()}:
        message = "complete, and not in the index; run recover"
        try:
            read_about(root / EPISODES_FOLDER / name)
        except CorruptEpisode as err:
            message = f"not in the index, and cannot be read: {err}"
        except DatasetError as err:
            message = str(err)
        yield Finding("warning", "unlisted", None, _in(root, root / EPISODES_FOLDER / name), message)


def check_beside(root: Path) -> list[Finding]:
    """Return what killed programs that were to make this folder, or something in its place, left beside it."""
    message = f"beside {root.name}, left by a killed program; `rcs-data check --repair` removes it"
    return [Finding("warning", "left_over", None, path.name, message) for path in leftovers(root)]


def _in(root: Path, path: Path) -> str:
    return str(path.relative_to(root))
