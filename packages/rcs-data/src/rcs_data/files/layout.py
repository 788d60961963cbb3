"""Paths in a dataset's folder, and valid names of episodes (`docs/layout.md`)."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path

from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.text import is_storable

DATASET_FILE = "dataset.json"
"""File with the facts that the episodes share; a copy is beside the history."""
INDEX_FILE = "episodes.jsonl"
"""The index: a line per episode."""
EPISODE_FILE = "episode.json"
STEPS_FILE = "steps.parquet"
FRAMES_FILE = "frames.zip"
ROWS_FILE = "rows.arrows"
"""The append-only stream of an episode that is still open."""
CHECKSUMS_FILE = "rows.crc"
"""The sizes and checksums of what was written to the stream."""
ABORTED_FILE = "aborted.json"
"""Why an open episode was aborted."""

EPISODES_FOLDER = "episodes"
OPEN_FOLDER = "open"
"""Episodes that are being recorded, or were when their writer died."""
FORMER_FOLDER = "former"
"""Episodes that edits replaced or dropped; `undo` brings them back, `prune` removes them."""
HISTORY_FOLDER = "history"
"""The index before each edit, and what the edit did."""
EDIT_FOLDER = ".edit"
"""An edit that is decided, but whose files are not yet in their places; they are there only for a moment."""
DRAFT_FOLDER = ".edit-draft"
"""An edit in preparation; garbage when its program is gone."""
TRASH_FOLDER = ".trash"
"""Folder of what is about to be removed."""
QUARANTINE_FOLDER = "quarantine"
"""Damaged files that a repair put aside, unchanged; nothing reads them."""
FOLDERS = (EPISODES_FOLDER, OPEN_FOLDER, FORMER_FOLDER, HISTORY_FOLDER, QUARANTINE_FOLDER, TRASH_FOLDER)

_LONGEST_NAME, _LONGEST_FOLDER = 200, 240  # of an episode, a folder's name may have a number after the id
_WRITTEN, _AGAIN = "@", "+"
_REMOVED = ".removed"
_OF_ANOTHER = re.compile(r".*[@+][0-9]+")


def is_name(text: str, longest: int = _LONGEST_NAME) -> bool:
    """Return whether a text, of so many bytes at most, can name a file or folder without leading elsewhere."""
    return (
        bool(text)
        and text.isprintable()  # which half a surrogate pair is not
        and "/" not in text
        and "\\" not in text
        and text[0] != "."
        and len(text.encode()) <= longest
    )


def check_name(text: object, what: str) -> None:
    """Refuse a text that cannot name a file or folder, or would lead out of its folder.

    Every name from a file or user that becomes part of a path is checked here.

    Args:
        text: The name.
        what: Kind of thing that it names, for the message, such as "an episode".

    Raises:
        InvalidSetup: The name is empty, too long, starts with a dot or has a slash or a control character.
    """
    if not isinstance(text, str) or not is_name(text):
        raise InvalidSetup(
            f"{text!r} cannot name {what}: it must be 1 to {_LONGEST_NAME} bytes of printable text "
            "without '/' and '\\\\' and not start with '.'."
        )


def name_of(folder: Path) -> str:
    """Return the name of a dataset: that of its folder, reduced to what is valid everywhere."""
    letters = (letter if letter.isprintable() and letter not in "/\\" else "_" for letter in folder.resolve().name)
    name = "".join(letters).lstrip(".")
    while len(name.encode()) > _LONGEST_NAME // 2:  # leaves room for a number or an id
        name = name[:-1]
    return name or "dataset"


def check_episode_id(episode_id: str) -> None:
    """Refuse an id that cannot name a folder, or looks like the folder of another episode.

    Raises:
        InvalidSetup: The id is empty, too long, starts with a dot, has a slash or a control character, or ends in "@"
            or "+" and a number.
    """
    check_name(episode_id, "an episode")
    if _OF_ANOTHER.fullmatch(episode_id):
        raise InvalidSetup(f"{episode_id!r} cannot name an episode: it must not end in '@' or '+' and a number.")


def unwritable_links(root: Path) -> list[Path]:
    """Return the links of a dataset, which may itself be one: folders that lead out of it, and files.

    Reading follows them, so a dataset may be composed of links. Writing does not: their targets may belong to somebody
    else.
    """
    inside = root.resolve()
    folders = (root / name for name in FOLDERS)
    found = [path for path in folders if path.is_symlink() and not _resolved(path).is_relative_to(inside)]
    return found + [path for name in (INDEX_FILE, DATASET_FILE) if (path := root / name).is_symlink()]


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a link to itself
        return Path("/")


def check_path(path: Path) -> None:
    """Refuse a path that is not UTF-8: Arrow opens no such file.

    Every path from a user, of what is to be read or made, is checked here.

    Raises:
        DatasetError: The path is not UTF-8.
    """
    if not is_storable(str(path.absolute())):
        raise DatasetError(f"The path is not UTF-8: {str(path.absolute())!r}. Rename its folders, or choose another.")


def has_dataset(root: Path) -> bool:
    """Return whether there is a dataset in a folder."""
    return (root / INDEX_FILE).exists()


def present_folder(folder: Path) -> Path:
    """Return where an episode's folder is, given its place: an edit may just bring it there, or have replaced it."""
    root = folder.parent.parent
    places = (folder, root / FORMER_FOLDER / folder.name, root / EDIT_FOLDER / EPISODES_FOLDER / folder.name)
    return next((place for place in places if place.is_dir()), folder)


def free_folder(root: Path, episode_id: str) -> Path:
    """Return the folder for a recorded episode: its id, with a number if another episode has that, or had."""
    folder = root / EPISODES_FOLDER / episode_id
    number = 0
    while folder.exists() or (root / FORMER_FOLDER / folder.name).exists():
        number += 1
        folder = root / EPISODES_FOLDER / f"{episode_id}{_AGAIN}{number}"
    return folder


def new_trash(root: Path, name: str) -> Path:
    """Return a free place for a folder about to be removed."""
    return root / TRASH_FOLDER / f"{name}-{secrets.token_hex(4)}"


def written_folder(episode_id: str, number: int) -> str:
    """Return the name of the folder that the edit of a number writes for an episode."""
    return f"{episode_id}{_WRITTEN}{number}"


def edit_number(folder: str) -> int:
    """Return the number of the edit that wrote a folder, given its name; 0 if no edit did."""
    _, mark, number = folder.rpartition(_WRITTEN)
    return int(number) if mark and number.isascii() and number.isdecimal() else 0


def folder_names(root: Path, folder: str = EPISODES_FOLDER) -> list[str]:
    """Return the sorted names of the folders of episodes, complete, open or former ones, whether listed or not."""
    return sorted(name for name in _names(root / folder) if _is_folder(name))


def strange_names(root: Path) -> list[str]:
    """Return entries beside the episodes whose names cannot be episodes; nothing reads them."""
    return sorted(name for name in _names(root / EPISODES_FOLDER) if not _is_folder(name))


def trash(root: Path) -> list[Path]:
    """Return the remains of what was removed or was not completed; nothing reads them."""
    drafts = [root / DRAFT_FOLDER] if (root / DRAFT_FOLDER).exists() else []
    pruned = [root / FORMER_FOLDER / name for name in _names(root / FORMER_FOLDER) if not _is_folder(name)]
    thrown = [root / TRASH_FOLDER / name for name in _names(root / TRASH_FOLDER) if not name.endswith(_REMOVED)]
    return [*drafts, *pruned, *thrown]


def removal_mark(root: Path, name: str) -> Path:
    """Return the mark that an episode is being removed, given its folder's name; it goes when the folder is gone."""
    return root / TRASH_FOLDER / f"{name}{_REMOVED}"


def removals(root: Path) -> dict[Path, Path]:
    """Return the marks of removals that a kill cut short, each with the folder that is to go unless it is listed."""
    names = [name.removesuffix(_REMOVED) for name in _names(root / TRASH_FOLDER) if name.endswith(_REMOVED)]
    return {removal_mark(root, name): root / EPISODES_FOLDER / name for name in names if _is_folder(name)}


def _is_folder(name: str) -> bool:
    return is_name(name, _LONGEST_FOLDER)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
