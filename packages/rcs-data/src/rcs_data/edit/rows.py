"""Cuts rows out of the numbers of an episode.

These fit into memory also for an episode with many gigabytes of images, which are read when the rows are written.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.info import SIM_STATE, DatasetInfo


def take_rows(table: pa.Table, info: DatasetInfo, rows: Sequence[int] | NDArray[np.intp]) -> pa.Table:
    """Return some rows, ascending, as an episode of their own; values repeated from an earlier row are filled in.

    The new first row loses action and reward, since the step before it is not part of the episode.
    """
    chosen = np.asarray(rows, np.int64)
    columns: list[pa.Array] = []
    for field in table.schema:
        column = table.column(field.name).combine_chunks()
        feature = None if field.name == SIM_STATE else info.feature(field.name)
        if feature is not None and feature.encoding == "held":
            columns.append(_take_held(column, chosen))
        elif feature is not None and (feature.is_unknown_at_reset or feature.key == "time/period") and len(chosen):
            columns.append(pa.concat_arrays([pa.nulls(1, field.type), column.take(pa.array(chosen[1:]))]))
        else:
            columns.append(column.take(pa.array(chosen)))
    return pa.Table.from_arrays(columns, schema=table.schema)


def last_valid(column: pa.Array) -> NDArray[np.int64]:
    """Return for each row the last row up to it that has a value, or -1."""
    rows = np.where(column.is_valid().to_numpy(zero_copy_only=False), np.arange(len(column)), -1)
    return np.maximum.accumulate(rows) if len(rows) else rows


def _take_held(column: pa.Array, rows: NDArray[np.int64]) -> pa.Array:
    origin = last_valid(column)[rows]
    # Null where the value repeats the row before, and where there is none yet.
    is_null = (np.diff(origin, prepend=-1) == 0) | (origin < 0)
    return column.take(pa.array(np.where(is_null, 0, origin), mask=is_null))
