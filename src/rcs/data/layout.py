"""Where things are in a dataset's folder, and which names an episode may have.

Two folders matter: the dataset's (`root`), which has `dataset.json` and the locks, and the one that has the current
episodes (`base`): the same until the first edit, then that of a generation.
"""

from __future__ import annotations

import secrets
from pathlib import Path

from rcs.errors import InvalidSetup

DATASET_FILE = "dataset.json"
COPY_FILE = "dataset.copy.json"
"""The same once more, for the day that a bit of the other one flips."""
EPISODE_FILE = "episode.json"
STEPS_FILE = "steps.parquet"
SIM_STATE_FILE = "sim_state.parquet"
ROWS_FILE = "rows.arrows"
"""The append-only stream of an episode that is still open."""
ABORTED_FILE = "aborted.json"
"""Why an open episode was given up."""

EPISODES_FOLDER = "episodes"
GENERATIONS_FOLDER = "generations"
QUARANTINE_FOLDER = "quarantine"
"""What a repair found damaged, as it was; nothing reads it."""
_OPEN = ".open-"
_LONGEST_NAME = 200
MOST_GENERATIONS = 10**9 - 1
"""The largest number of a generation, one for each edit; its folder has four digits, and more when it needs them."""
_DISCARDED = ".discarded-"


def is_name(text: str) -> bool:
    """Return whether a text can be the name of a file or folder, and of nothing but one beside the others."""
    return (
        bool(text)
        and text.isprintable()  # which half of a surrogate pair is not
        and not {"/", "\\"} & set(text)
        and text[0] != "."
        and len(text.encode()) <= _LONGEST_NAME
    )


def check_name(text: object, what: str) -> None:
    """Refuse a text that could not be the name of a file or folder, or that would lead out of its folder.

    Every name that comes from a file or a user and becomes part of a path goes through here.

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
    """Return what a dataset is called by others: the name of its folder, as far as that can be a name anywhere."""
    letters = (letter if letter.isprintable() and letter not in "/\\" else "_" for letter in folder.resolve().name)
    name = "".join(letters).lstrip(".")
    while len(name.encode()) > _LONGEST_NAME // 2:  # with room for a number or an id behind it
        name = name[:-1]
    return name or "dataset"


def check_episode_id(episode_id: str) -> None:
    """Refuse an id that could not be the name of a folder.

    Raises:
        InvalidSetup: The id is empty, too long, starts with a dot or has a slash or a control character.
    """
    check_name(episode_id, "an episode")


def links_out(root: Path) -> list[Path]:
    """Return the folders of a dataset that are links and lead out of it.

    Reading goes through them, so a dataset may be put together of links. Writing does not: what is behind them may be
    anybody's.

    Args:
        root: The dataset's folder, which may be a link itself.
    """
    bases = [root, *(generation_folder(root, number) for number in generations(root))]
    folders = [root / GENERATIONS_FOLDER, root / QUARANTINE_FOLDER, *bases[1:], *map(episodes_folder, bases)]
    inside = root.resolve()
    return [path for path in folders if path.is_symlink() and not _resolved(path).is_relative_to(inside)]


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a link that leads to itself
        return Path("/")


def generation_folder(root: Path, generation: int) -> Path:
    """Return the folder with the episodes folder of a generation; that of 0 is the dataset's own."""
    return root if generation == 0 else root / GENERATIONS_FOLDER / f"{generation:04d}"


def generations(root: Path) -> list[int]:
    """Return the numbers of the generations on the disk but the first, sorted; of a killed edit, too."""
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
    """Return a free name for a folder that is about to be removed."""
    return base / EPISODES_FOLDER / f"{_DISCARDED}{episode_id}-{secrets.token_hex(4)}"


def complete_ids(base: Path) -> list[str]:
    """Return the ids of the complete episodes, sorted."""
    return sorted(name for name in _names(base) if is_name(name) and _has_description(base, name))


def incomplete_ids(base: Path) -> list[str]:
    """Return the names of folders that have no `episode.json` though they look complete; no kill leaves such."""
    return sorted(name for name in _names(base) if is_name(name) and not _has_description(base, name))


def strange_names(base: Path) -> list[str]:
    """Return what lies beside the episodes and cannot be one by its name; nothing reads it."""
    names = (name for name in _names(base) if not name.startswith(_DISCARDED))
    return sorted(name for name in names if not is_name(name.removeprefix(_OPEN)))


def open_ids(base: Path) -> list[str]:
    """Return the ids of the episodes that are being recorded, or were when their writer died, sorted."""
    names = (name.removeprefix(_OPEN) for name in _names(base) if name.startswith(_OPEN))
    return sorted(name for name in names if is_name(name))


def trash_folders(base: Path) -> list[Path]:
    """Return what is left of discarded episodes."""
    return [base / EPISODES_FOLDER / name for name in _names(base) if name.startswith(_DISCARDED)]


def _has_description(base: Path, name: str) -> bool:
    return (episode_folder(base, name) / EPISODE_FILE).exists()


def _names(base: Path) -> list[str]:
    try:
        return [path.name for path in (base / EPISODES_FOLDER).iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
