"""Where things are in a dataset's folder, and which names an episode may have.

Two folders matter: the dataset's (`root`), which has `dataset.json` and the locks, and the one that has the current
episodes (`base`): the same until the first edit, then that of a generation.
"""

from __future__ import annotations

import os
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
_DISCARDED = ".discarded-"


def check_episode_id(episode_id: str) -> None:
    """Refuse an id that could not be the name of a folder.

    Raises:
        InvalidSetup: The id is empty, too long, starts with a dot or has a slash or a control character.
    """
    is_name = bool(episode_id) and episode_id.isprintable() and "/" not in episode_id and episode_id[0] != "."
    if not is_name or len(os.fsencode(episode_id)) > 200:
        raise InvalidSetup(
            f"{episode_id!r} cannot name an episode: it must be 1 to 200 bytes of printable text "
            "without '/' and not start with '.'."
        )


def generation_folder(root: Path, generation: int) -> Path:
    """Return the folder with the episodes folder of a generation; that of 0 is the dataset's own."""
    return root if generation == 0 else root / GENERATIONS_FOLDER / f"{generation:04d}"


def generations(root: Path) -> list[int]:
    """Return the numbers of the generations on the disk but the first, sorted; of a killed edit, too."""
    try:
        names = [path.name for path in (root / GENERATIONS_FOLDER).iterdir()]
    except FileNotFoundError:
        return []
    return sorted(int(name) for name in names if name.isdigit())


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
    return sorted(
        name
        for name in _names(base)
        if not name.startswith(".") and (episode_folder(base, name) / EPISODE_FILE).exists()
    )


def incomplete_ids(base: Path) -> list[str]:
    """Return the names of folders that have no `episode.json` though they look complete; no kill leaves such."""
    return sorted(
        name
        for name in _names(base)
        if not name.startswith(".") and not (episode_folder(base, name) / EPISODE_FILE).exists()
    )


def open_ids(base: Path) -> list[str]:
    """Return the ids of the episodes that are being recorded, or were when their writer died, sorted."""
    return sorted(name.removeprefix(_OPEN) for name in _names(base) if name.startswith(_OPEN))


def trash_folders(base: Path) -> list[Path]:
    """Return what is left of discarded episodes."""
    return [base / EPISODES_FOLDER / name for name in _names(base) if name.startswith(_DISCARDED)]


def _names(base: Path) -> list[str]:
    try:
        return [path.name for path in (base / EPISODES_FOLDER).iterdir()]
    except FileNotFoundError:
        return []
