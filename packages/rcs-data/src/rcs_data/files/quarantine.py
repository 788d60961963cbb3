"""Puts damaged files of a dataset aside, unchanged, where nothing reads them."""

from __future__ import annotations

from pathlib import Path

from rcs_data.errors import DatasetError
from rcs_data.files.durable import sync_folder
from rcs_data.files.layout import QUARANTINE_FOLDER


def quarantine(root: Path, path: Path, name: str = "") -> Path:
    """Move a file or folder to a free name in the quarantine, and return that.

    Args:
        root: The dataset's folder.
        path: The file or folder.
        name: Model for its name there; the name that it has if this is empty.

    Raises:
        DatasetError: It cannot be moved.
        OSError: The disk is full or fails.
    """
    folder = root / QUARANTINE_FOLDER
    folder.mkdir(exist_ok=True)
    target = folder / (name or path.name)
    number = 1
    while target.exists():
        number += 1
        target = folder / f"{name or path.name}-{number}"
    try:
        path.rename(target)
    except OSError as err:
        raise DatasetError(f"Cannot move {path} to {target}: {err.strerror or err}.") from err
    sync_folder(folder)
    sync_folder(path.parent)
    return target
