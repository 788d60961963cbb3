"""Paths in a dataset's folder, and valid names of episodes.

There are two folders: that of the dataset (`root`), with `dataset.json` and the locks, and that of the current episodes
(`base`), which is the same until the first edit, then that of a generation.
"""

from __future__ import annotations

import secrets
from pathlib import Path

from rcs_data.errors import InvalidSetup

DATASET_FILE = "dataset.json"
COPY_FILE = "dataset.copy.json"
"""Backup of `dataset.json`, read if that is damaged."""
EPISODE_FILE = "episode.json"
STEPS_FILE = "steps.parquet"
FRAMES_FILE = "frames.arrow"
ROWS_FILE = "rows.arrows"
"""The append-only stream of an episode that is still open."""
ABORTED_FILE = "aborted.json"
"""Why an open episode was aborted."""

EPISODES_FOLDER = "episodes"
GENERATIONS_FOLDER = "generations"
QUARANTINE_FOLDER = "quarantine"
"""Damaged files that a repair put aside, unchanged; nothing reads them."""
_OPEN = ".open-"
_LONGEST_NAME = 200
MOST_GENERATIONS = 10**9 - 1
"""The largest number of a generation, one for each edit; its folder has four digits, or more if needed."""
_DISCARDED = ".discarded-"


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
    """Refuse an id that cannot name a folder.

    Raises:
        InvalidSetup: The id is empty, too long, starts with a dot or has a slash or a control character.
    """
    check_name(episode_id, "an episode")


def links_out(root: Path) -> list[Path]:
    """Return the folders of a dataset that are links out of it.

    Reading follows them, so a dataset may be composed of links. Writing does not: their targets may belong to somebody
    else.

    Args:
        root: The dataset's folder; it may itself be a link.
    """
    bases = [root, *(generation_folder(root, number) for number in generations(root))]
    folders = [root / GENERATIONS_FOLDER, root / QUARANTINE_FOLDER, *bases[1:], *map(episodes_folder, bases)]
    inside = root.resolve()
    return [path for path in folders if path.is_symlink() and not _resolved(path).is_relative_to(inside)]


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a link to itself
        return Path("/")


def generation_folder(root: Path, generation: int) -> Path:
    """Return the folder of a generation; that of 0 is the dataset's own."""
    return root if generation == 0 else root / GENERATIONS_FOLDER / f"{generation:04d}"


def generations(root: Path) -> list[int]:
    """Return the sorted numbers of the generations on disk except 0, including those of killed edits."""
    try:
        names = [path.name for path in (root / GENERATIONS_FOLDER).iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(
        int(name) for name in names if name.isdecimal() and name.isascii() and len(name) <= len(str(MOST_GENERATIONS))
    )


def episodes_folder(base: Path) -> Path:
    """Return the folder with all episodes."""
    return base / EPISODES_FOLDER


def episode_folder(base: Path, episode_id: str) -> Path:
    """Return the folder of a complete episode."""
    return base / EPISODES_FOLDER / episode_id


def open_folder(base: Path, episode_id: str) -> Path:
    """Return the folder of an episode that is being recorded."""
    return base / EPISODES_FOLDER / f"{_OPEN}{episode_id}"


def new_trash_folder(base: Path, episode_id: str) -> Path:
    """Return a free name for a folder about to be removed."""
    return base / EPISODES_FOLDER / f"{_DISCARDED}{episode_id}-{secrets.token_hex(4)}"


def complete_ids(base: Path) -> list[str]:
    """Return the ids of the complete episodes, sorted."""
    return sorted(name for name in _names(base) if is_name(name) and _has_description(base, name))


def incomplete_ids(base: Path) -> list[str]:
    """Return the names of folders that look complete but have no `episode.json`; no kill leaves these."""
    return sorted(name for name in _names(base) if is_name(name) and not _has_description(base, name))


def strange_names(base: Path) -> list[str]:
    """Return entries beside the episodes whose names cannot be episodes; nothing reads them."""
    names = (name for name in _names(base) if not name.startswith(_DISCARDED))
    return sorted(name for name in names if not is_name(name.removeprefix(_OPEN)))


def open_ids(base: Path) -> list[str]:
    """Return the sorted ids of the open episodes: being recorded, or left by a dead writer."""
    names = (name.removeprefix(_OPEN) for name in _names(base) if name.startswith(_OPEN))
    return sorted(name for name in names if is_name(name))


def trash_folders(base: Path) -> list[Path]:
    """Return the remains of discarded episodes."""
    return [base / EPISODES_FOLDER / name for name in _names(base) if name.startswith(_DISCARDED)]


def _has_description(base: Path, name: str) -> bool:
    return (episode_folder(base, name) / EPISODE_FILE).exists()


def _names(base: Path) -> list[str]:
    try:
        return [path.name for path in (base / EPISODES_FOLDER).iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
