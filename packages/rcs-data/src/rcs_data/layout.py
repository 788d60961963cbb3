"""Paths in a dataset's folder, and valid names of episodes."""

from __future__ import annotations

import re
import secrets
from collections.abc import Collection
from pathlib import Path

from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.text import is_storable

DATASET_FILE = "dataset.json"
"""What the episodes share, for people and for repairs; the index has it too, and that is what is read."""
JOURNAL_FILE = "episodes.jsonl"
"""The index: which episodes there are, and what happened to them."""
EPISODE_FILE = "episode.json"
STEPS_FILE = "steps.parquet"
FRAMES_FILE = "frames.arrow"
ROWS_FILE = "rows.arrows"
"""The append-only stream of an episode that is still open."""
ABORTED_FILE = "aborted.json"
"""Why an open episode was aborted."""

EPISODES_FOLDER = "episodes"
QUARANTINE_FOLDER = "quarantine"
"""Damaged files that a repair put aside, unchanged; nothing reads them."""
_OPEN = ".open-"
_LONGEST_NAME = 200
_DISCARDED = ".discarded-"
_WRITTEN, _AGAIN = "@", "+"
_OF_ANOTHER = re.compile(r".*[@+][0-9]+")
_BY_AN_EDIT = re.compile(r".+@([0-9]+)")


def is_name(text: str) -> bool:
    """Return whether a text can name a file or folder without leading elsewhere."""
    return (
        bool(text)
        and text.isprintable()  # which half a surrogate pair is not
        and not {"/", "\\"} & set(text)
        and text[0] != "."
        and len(text.encode()) <= _LONGEST_NAME
    )


def check_name(text: object, what: str) -> None:
    """Refuse a text that cannot name a file or folder, or would lead out of its folder.

    Every name from a file or user that becomes part of a path is checked here.

    Args:
        text: The name.
        what: What it names, for the message, such as "an episode".

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
    folders = (root / QUARANTINE_FOLDER, episodes_folder(root))
    files = (root / JOURNAL_FILE, root / DATASET_FILE)
    found = [path for path in folders if path.is_symlink() and not _resolved(path).is_relative_to(inside)]
    return found + [path for path in files if path.is_symlink()]


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
    return (root / JOURNAL_FILE).exists()


def episodes_folder(root: Path) -> Path:
    """Return the folder with all episodes."""
    return root / EPISODES_FOLDER


def episode_folder(root: Path, name: str) -> Path:
    """Return the folder of a complete episode by its name, which is that in the index."""
    return root / EPISODES_FOLDER / name


def free_folder(root: Path, episode_id: str, removed: Collection[str]) -> Path:
    """Return the folder for a recorded episode: its id, with a number if another episode has that, or had.

    Args:
        root: The dataset's folder.
        episode_id: The episode.
        removed: Names of folders that were removed; readers may still know what was in them.
    """
    folder = episode_folder(root, episode_id)
    number = 0
    while folder.name in removed or folder.exists():
        number += 1
        folder = episode_folder(root, f"{episode_id}{_AGAIN}{number}")
    return folder


def open_folder(root: Path, episode_id: str) -> Path:
    """Return the folder of an episode that is being recorded."""
    return root / EPISODES_FOLDER / f"{_OPEN}{episode_id}"


def new_trash_folder(root: Path, episode_id: str) -> Path:
    """Return a free name for a folder about to be removed."""
    return root / EPISODES_FOLDER / f"{_DISCARDED}{episode_id}-{secrets.token_hex(4)}"


def written_folder(episode_id: str, number: int) -> str:
    """Return the name of the folder that the edit of a number writes for an episode."""
    return f"{episode_id}{_WRITTEN}{number}"


def edit_number(folder: str) -> int:
    """Return the number of the edit that wrote a folder, given its name; 0 if it was recorded."""
    found = _BY_AN_EDIT.fullmatch(folder)
    return int(found[1]) if found else 0


def folder_names(root: Path) -> list[str]:
    """Return the sorted names of the folders of complete episodes, whether the index has them or not."""
    return sorted(name for name in _names(root) if is_name(name))


def strange_names(root: Path) -> list[str]:
    """Return entries beside the episodes whose names cannot be episodes; nothing reads them."""
    names = (name for name in _names(root) if not name.startswith(_DISCARDED))
    return sorted(name for name in names if not is_name(name.removeprefix(_OPEN)))


def open_ids(root: Path) -> list[str]:
    """Return the sorted ids of the open episodes: being recorded, or left by a dead writer."""
    names = (name.removeprefix(_OPEN) for name in _names(root) if name.startswith(_OPEN))
    return sorted(name for name in names if is_name(name))


def trash_folders(root: Path) -> list[Path]:
    """Return the remains of discarded episodes."""
    return [root / EPISODES_FOLDER / name for name in _names(root) if name.startswith(_DISCARDED)]


def _names(root: Path) -> list[str]:
    try:
        return [path.name for path in (root / EPISODES_FOLDER).iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
