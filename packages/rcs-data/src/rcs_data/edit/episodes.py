"""Edits of whole episodes: delete, keep, trim, relabel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.edit.transaction import editing
from rcs_data.errors import InvalidSetup
from rcs_data.files.info import SIM_STATE, DatasetInfo
from rcs_data.files.text import check_text
from rcs_data.index.history import RELABEL
from rcs_data.options import require_whole

_OF_THE_STEP = ("time/period", "time/command")
"""Times of the step that led to a row."""


def delete(path: str | Path, episodes: Iterable[str]) -> None:
    """Delete episodes of a dataset.

    Raises:
        InvalidSetup: There is no such episode; nothing is deleted.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing is deleted.
    """
    ids = sorted(set(episodes))
    with editing(path, "delete", {"episodes": ids}) as edit:
        require_ids(path, edit.entries, ids)
        for name in ids:
            del edit.entries[name]


def keep(path: str | Path, episodes: Iterable[str]) -> None:
    """Delete all episodes but some.

    Raises:
        InvalidSetup: There is no such episode; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    ids = sorted(set(episodes))
    with editing(path, "keep", {"episodes": ids}) as edit:
        require_ids(path, edit.entries, ids)
        for name in edit.entries.keys() - set(ids):
            del edit.entries[name]


def trim(path: str | Path, episode: str, *, first: int = 0, last: int = -1) -> None:
    """Cut rows off the start and end of an episode; its verdict stays the same.

    Args:
        path: The dataset.
        episode: The id.
        first: The row that becomes the first; its observation is the new reset observation.
        last: The row that becomes the last; negative numbers count from the end, -1 being the last.

    Raises:
        InvalidSetup: There is no such episode, a row is not a whole number, or none would stay; nothing changes.
        CorruptEpisode: The episode is damaged; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    first, last = require_whole("first", first, None), require_whole("last", last, None)
    with editing(path, "trim", {"episode": episode, "first": first, "last": last}) as edit:
        require_ids(path, edit.entries, [episode])
        record = edit.dataset[episode]
        end = record.length + last if last < 0 else last
        if not 0 <= first <= end < record.length:
            raise InvalidSetup(
                f"Expected rows of episode {episode!r} between 0 and {record.length - 1}, the first not after the "
                f"last; got {first} to {last}."
            )
        edit.write(record, record.inlined(take_rows(record.steps(), record.info, range(first, end + 1))))


def relabel(path: str | Path, instruction: str, *, episodes: Iterable[str] | None = None) -> None:
    """Change the robot's instruction in some episodes; None for all, and for those recorded later.

    Raises:
        InvalidSetup: There is no such episode; nothing changes.
        DatasetError: Another process writes to the dataset, or the disk fails; nothing changes.
    """
    check_text(instruction, "The instruction")
    ids = None if episodes is None else sorted(set(episodes))
    arguments = {"instruction": instruction, "episodes": ids}
    words = None if ids is None else instruction  # an episode without its own has the dataset's
    new_info = (lambda info: replace(info, instruction=instruction)) if ids is None else (lambda info: info)
    with editing(path, RELABEL, arguments, new_info=new_info) as edit:
        require_ids(path, edit.entries, ids or [])
        for name in edit.entries if ids is None else ids:
            edit.entries[name] = msgspec.structs.replace(edit.entries[name], instruction=words)


def take_rows(table: pa.Table, info: DatasetInfo, rows: Sequence[int] | NDArray[np.intp]) -> pa.Table:
    """Return some rows of an episode, ascending, as an episode of their own.

    The new first row loses action and reward, since the step before it is not part of the episode. The numbers of an
    episode fit into memory also where its images take many gigabytes, which are read when the rows are written.
    """
    chosen = pa.array(np.asarray(rows, np.int64))
    columns: list[pa.Array] = []
    for field in table.schema:
        column = table.column(field.name).combine_chunks()
        feature = None if field.name == SIM_STATE else info.feature(field.name)
        if feature is not None and (feature.is_unknown_at_reset or feature.key in _OF_THE_STEP) and len(chosen):
            columns.append(pa.concat_arrays([pa.nulls(1, field.type), column.take(chosen[1:])]))
        else:
            columns.append(column.take(chosen))
    return pa.Table.from_arrays(columns, schema=table.schema)


def require_ids(path: str | Path, known: Iterable[str], ids: Iterable[str]) -> None:
    """Refuse unknown ids.

    Args:
        path: The dataset, for the message.
        known: The ids of its episodes.
        ids: Those that are selected.

    Raises:
        InvalidSetup: There is no such episode; the message lists some that exist.
    """
    if missing := sorted(set(ids).difference(known)):
        first = sorted(known)[:6]
        some = ", ".join(first[:5]) + (" …" if len(first) > 5 else "")
        raise InvalidSetup(
            f"There is no episode {', '.join(missing)} in {Path(path).absolute()}; it has {some or 'none'}."
        )
