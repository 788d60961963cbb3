"""`dataset.json`: what the episodes share, which generation of them is current, and its history.

An edit never changes an episode. It makes a new folder of episodes, a generation, in which unchanged ones are links to
the same files. Replacing `dataset.json` by one that names the new generation is the edit itself, and replacing it by
one that names the former generation undoes it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rcs_data.durable import disk_errors, sealed, sync_folder, unsealed, write_file
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.info import SCHEMA_VERSION, DatasetInfo
from rcs_data.json_file import read_bytes
from rcs_data.layout import COPY_FILE, DATASET_FILE, MOST_GENERATIONS, generation_folder

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Edit:
    """One line of a dataset's history."""

    command: str
    """What was done, such as "delete" or "undo"."""
    arguments: dict[str, Any]
    """Its arguments, as JSON values."""
    at: str
    """Wall clock, ISO 8601 in UTC."""
    before: int
    """The generation that was current before."""
    after: int
    """The generation that is current after."""
    episodes: tuple[str, ...]
    """The ids of the episodes after the edit."""
    info: dict[str, Any]
    """What the episodes shared before, as JSON; undo restores it."""


@dataclass(frozen=True, kw_only=True)
class Head:
    """The contents of `dataset.json`."""

    info: DatasetInfo
    """What the episodes of the current generation share."""
    generation: int = 0
    """The current generation; 0 is what was recorded."""
    history: tuple[Edit, ...] = ()
    """The history, oldest first."""

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {
            **self.info.to_json(),
            "generation": self.generation,
            "history": [asdict(edit) for edit in self.history],
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Head:
        """Build the head from what `to_json` returned, or from a dataset of schema version 1, which had no edits.

        Raises:
            DatasetError: The layout is newer than this code.
            InvalidSetup: A field is missing, unknown or does not make sense.
        """
        own = ("generation", "history")
        info = DatasetInfo.from_json({key: value for key, value in values.items() if key not in own})
        generation, history = values.get("generation", 0), values.get("history", [])
        if not _is_generation(generation) or not isinstance(history, list):
            raise InvalidSetup(f"The generation is {generation!r:.80}, and the history a {type(history).__name__}.")
        return cls(info=info, generation=generation, history=tuple(map(_edit, history)))


def _is_generation(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_GENERATIONS


def _edit(values: Any) -> Edit:
    """Build a line of the history from JSON.

    Raises:
        InvalidSetup: A field is missing, unknown or does not make sense.
    """
    try:
        fields: dict[str, Any] = {**values, "episodes": tuple(values["episodes"])}
        edit = Edit(**fields)
    except (KeyError, TypeError, ValueError) as err:
        raise InvalidSetup(f"Not a line of a dataset's history: {err!r}.") from err
    are_texts = isinstance(edit.command, str) and isinstance(edit.at, str)
    are_objects = isinstance(edit.arguments, dict) and isinstance(edit.info, dict)
    has_ids = isinstance(values["episodes"], list) and all(isinstance(name, str) for name in edit.episodes)
    if not (are_texts and are_objects and has_ids and _is_generation(edit.before) and _is_generation(edit.after)):
        raise InvalidSetup(f"Not a line of a dataset's history: {values!r:.200}.")
    return edit


def read_head(root: Path) -> Head:
    """Read `dataset.json`, or its copy if it is damaged or missing.

    Args:
        root: The dataset's folder.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
        CorruptEpisode: Both files are damaged.
    """
    try:
        return read_head_file(root / DATASET_FILE)
    except (CorruptEpisode, DatasetError) as err:
        if (root / DATASET_FILE).exists() and not isinstance(err, CorruptEpisode):
            raise  # a newer layout, or a failing disk
        try:
            head = read_head_file(root / COPY_FILE)
        except (CorruptEpisode, DatasetError):
            raise err from None
        _log.warning("%s; read from its copy %s. `rcs data check --repair` repairs it.", err, COPY_FILE)
        return head


def has_head(root: Path) -> bool:
    """Return whether there is a dataset in a folder: `dataset.json`, or at least its copy."""
    return (root / DATASET_FILE).exists() or (root / COPY_FILE).exists()


def read_head_file(path: Path) -> Head:
    """Read `dataset.json` or its copy, and nothing else.

    Raises:
        DatasetError: There is no such file, or its layout is newer than this code.
        CorruptEpisode: It is damaged.
    """
    if not path.exists():
        raise DatasetError(f"There is no dataset in {path.parent}: {path.name} is missing.")
    with disk_errors("read the dataset", path):
        values = unsealed(read_bytes(path), path)
    try:
        return Head.from_json(values)
    except InvalidSetup as err:
        raise CorruptEpisode(f"{path} is damaged: {err}") from err


def write_head(root: Path, head: Head) -> None:
    """Replace `dataset.json` in one step, and then its copy.

    Raises:
        OSError: The disk fails; either the old or the new file is there.
    """
    current = replace(head, info=replace(head.info, schema_version=SCHEMA_VERSION))
    data = sealed(current.to_json())
    write_file(root / DATASET_FILE, data)
    sync_folder(root)
    write_file(root / COPY_FILE, data)


def read_info(root: Path) -> DatasetInfo:
    """Read what a dataset's episodes share.

    Args:
        root: The dataset's folder.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
        CorruptEpisode: Both the file and its copy are damaged.
    """
    return read_head(root).info


def content_folder(root: Path) -> Path:
    """Return the folder with the current episodes: the dataset's own, or that of a generation.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
        CorruptEpisode: Both the file and its copy are damaged.
    """
    return generation_folder(root, read_head(root).generation)
