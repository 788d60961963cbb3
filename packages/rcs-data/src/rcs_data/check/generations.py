"""Checks a dataset's folder for damaged former generations, which undo restores, and for leftovers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rcs_data.about import read_about
from rcs_data.check.bytes import sha256_of
from rcs_data.check.descriptions import is_as_written
from rcs_data.check.report import Finding, Severity
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.head import Head
from rcs_data.json_file import read_bytes
from rcs_data.layout import (
    EPISODE_FILE,
    complete_ids,
    episode_folder,
    episodes_folder,
    generation_folder,
    generations,
    incomplete_ids,
    links_out,
    open_folder,
    open_ids,
    strange_names,
    trash_folders,
)
from rcs_data.lock import is_locked
from rcs_data.recover import unreachable_generations
from rcs_data.text import mended_text

_UNPRINTABLE = dict.fromkeys(range(32), "�")

REPAIR = "repair"
"""The history's command of a repair; its arguments name the damaged folders of former generations."""
DAMAGED = "damaged"


def check_leftovers(root: Path, head: Head) -> Iterator[Finding]:
    """Yield what a killed writer or edit left, and whole files that are missing.

    Args:
        root: The dataset's folder.
        head: The contents of `dataset.json`.
    """
    base = generation_folder(root, head.generation)
    if not episodes_folder(base).is_dir():
        yield _finding(root, "damage", "missing", None, episodes_folder(base), "missing, with all episodes in it")
    for episode_id in incomplete_ids(base):
        file = episode_folder(base, episode_id) / EPISODE_FILE
        message = "missing, so the episode is not read; --repair restores it from the rows"
        yield _finding(root, "damage", "missing", episode_id, file, message)
    if is_locked(root):
        return  # a living writer has open episodes
    for episode_id in open_ids(base):
        folder = open_folder(base, episode_id)
        yield _finding(root, "warning", "left_open", episode_id, folder, "open, and its writer is gone; run recover")
    for name in strange_names(base):
        file = episodes_folder(base) / mended_text(name).translate(_UNPRINTABLE)
        yield _finding(root, "warning", "stranger", None, file, "its name cannot be an episode's; nothing reads it")
    for folder in links_out(root):
        message = f"a link out of the dataset to {folder.readlink()}; it is read, but never written through"
        yield _finding(root, "warning", "link", None, folder, message)
    for folder in trash_folders(base):
        yield _finding(root, "warning", "left_over", None, folder, "left of a discard; run recover")
    for folder in unreachable_generations(root, head):
        yield _finding(root, "warning", "left_over", None, folder, "left of a killed edit; run recover")


def check_former(root: Path, head: Head) -> Iterator[Finding]:
    """Yield damage of episodes that are not current, except what a repair has already listed.

    Files that a current episode links to are checked there.

    Args:
        root: The dataset's folder.
        head: The contents of `dataset.json`.
    """
    known = known_damage(head)
    base = generation_folder(root, head.generation)
    current = {number for file in episodes_folder(base).glob("*/*") if (number := _number(file)) is not None}
    for folder in former_folders(root, head):
        if str(folder.relative_to(root)) in known:
            continue
        for file, message in _damage(folder, skip=current):
            text = f"{message}; undo would bring back a damaged episode"
            yield _finding(root, "damage", "former", folder.name, file, text)


def damaged_former(root: Path, head: Head) -> list[str]:
    """Return all damaged episode folders of former generations, relative to the dataset's folder."""
    folders = former_folders(root, head)
    return [str(folder.relative_to(root)) for folder in folders if any(_damage(folder, skip=set()))]


def known_damage(head: Head) -> set[str]:
    """Return the episode folders that repairs have listed as damaged, relative to the dataset's folder."""
    repairs = (edit for edit in head.history if edit.command == REPAIR)
    listed = (edit.arguments.get(DAMAGED) for edit in repairs)
    return {folder for folders in listed if isinstance(folders, list) for folder in folders if isinstance(folder, str)}


def former_folders(root: Path, head: Head) -> list[Path]:
    """Return the episode folders of the generations that undo can bring back."""
    rubbish = set(unreachable_generations(root, head))
    bases = [generation_folder(root, number) for number in (0, *generations(root)) if number != head.generation]
    return [
        episode_folder(base, name)
        for base in bases
        if base not in rubbish
        for name in sorted([*complete_ids(base), *incomplete_ids(base)])
    ]


def _damage(folder: Path, skip: set[int]) -> Iterator[tuple[Path, str]]:
    """Yield the damaged files of an episode, each with what is wrong."""
    path = folder / EPISODE_FILE
    is_shared = _number(path) in skip  # reported for the current episode
    try:
        about: dict[str, Any] = read_about(folder)
        if not is_shared and not is_as_written(read_bytes(path), about):
            yield path, "its bytes are not those that were written"
    except (CorruptEpisode, DatasetError) as err:
        if not is_shared:
            yield path, f"cannot be read: {err}"
        return
    for name, expected in about["sha256"].items():
        file = folder / name
        try:
            if _number(file) not in skip and sha256_of(file) != expected:
                yield file, "its SHA-256 differs from the one that was written"
        except OSError as err:
            yield file, f"cannot be read: {err.strerror or err}"


def _number(file: Path) -> int | None:
    """Return the inode of a file; None for a dangling link."""
    try:
        return file.stat().st_ino
    except OSError:
        return None


def _finding(root: Path, severity: Severity, kind: str, episode: str | None, path: Path, message: str) -> Finding:
    file = str(path.relative_to(root))
    return Finding(severity=severity, kind=kind, episode=episode, file=file, message=message)
