"""Where things are in a dataset's folder, and which names an episode may have."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from rcs.errors import InvalidSetup

DATASET_FILE = "dataset.json"
EPISODE_FILE = "episode.json"
STEPS_FILE = "steps.parquet"
SIM_STATE_FILE = "sim_state.parquet"
ROWS_FILE = "rows.arrows"
"""The append-only stream of an episode that is still open."""
ABORTED_FILE = "aborted.json"
"""Why an open episode was given up."""

EPISODES_FOLDER = "episodes"
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


def episodes_folder(root: Path) -> Path:
    """Return the folder with all episodes."""
    return root / EPISODES_FOLDER


def episode_folder(root: Path, episode_id: str) -> Path:
    """Return the folder of a complete episode."""
    return root / EPISODES_FOLDER / episode_id


def open_folder(root: Path, episode_id: str) -> Path:
    """Return the folder of an episode that is being recorded."""
    return root / EPISODES_FOLDER / f"{_OPEN}{episode_id}"


def new_trash_folder(root: Path, episode_id: str) -> Path:
    """Return a free name for a folder that is about to be removed."""
    return root / EPISODES_FOLDER / f"{_DISCARDED}{episode_id}-{secrets.token_hex(4)}"


def complete_ids(root: Path) -> list[str]:
    """Return the ids of the complete episodes, sorted."""
    return sorted(
        name
        for name in _names(root)
        if not name.startswith(".") and (episode_folder(root, name) / EPISODE_FILE).exists()
    )


def incomplete_ids(root: Path) -> list[str]:
    """Return the names of folders that have no `episode.json` though they look complete; no kill leaves such."""
    return sorted(
        name
        for name in _names(root)
        if not name.startswith(".") and not (episode_folder(root, name) / EPISODE_FILE).exists()
    )


def open_ids(root: Path) -> list[str]:
    """Return the ids of the episodes that are being recorded, or were when their writer died, sorted."""
    return sorted(name.removeprefix(_OPEN) for name in _names(root) if name.startswith(_OPEN))


def trash_folders(root: Path) -> list[Path]:
    """Return what is left of discarded episodes."""
    return [root / EPISODES_FOLDER / name for name in _names(root) if name.startswith(_DISCARDED)]


def _names(root: Path) -> list[str]:
    try:
        return [path.name for path in (root / EPISODES_FOLDER).iterdir()]
    except FileNotFoundError:
        return []
