"""Cuts rows out of the numbers of an episode.

These fit into memory also for an episode with many gigabytes of images, which are read when the rows are written.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.files.info import SIM_STATE, DatasetInfo

_OF_THE_STEP = ("time/period", "time/command")
"""Times of the step that led to a row."""


def take_rows(table: pa.Table, info: DatasetInfo, rows: Sequence[int] | NDArray[np.intp]) -> pa.Table:
    """Return some rows, ascending, as an episode of their own.

    The new first row loses action and reward, since the step before it is not part of the episode.
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
