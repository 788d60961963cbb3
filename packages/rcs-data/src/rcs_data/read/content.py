"""The content of episodes: a hash over all columns except times and flags."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.files.info import DatasetInfo

_NOTHING = pa.py_buffer(b"")


def flat_numbers(column: pa.ChunkedArray | pa.Array) -> NDArray[Any]:
    """Return the numbers of a column as one flat array; 0 where a row has no value."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if not pa.types.is_fixed_size_list(array.type):
        filled = array.fill_null(False if pa.types.is_boolean(array.type) else 0)
        return filled.to_numpy(zero_copy_only=False)
    # `flatten` would leave out the rows without a value, so the lists are read where they lie, and cleared.
    size = array.type.list_size
    values = array.values.slice(array.offset * size, len(array) * size)
    numbers = values.fill_null(False if pa.types.is_boolean(values.type) else 0).to_numpy(zero_copy_only=False)
    if array.null_count:
        numbers = np.where(np.repeat(_is_null(array), size), numbers.dtype.type(0), numbers)
    return numbers


class ContentHash:
    """SHA-256 over the values of all columns except times and flags, however the rows are split into tables.

    Per column: its key, for each row whether it has a value, and the values, little-endian and row-major, with 0 where
    there is none; for images the length and the bytes of each, as they are stored.
    """

    def __init__(self, info: DatasetInfo) -> None:
        """Start with no rows."""
        keys = sorted(feature.key for feature in info.features if not feature.is_circumstance)
        self._columns = {key: (hashlib.sha256(), hashlib.sha256()) for key in keys}

    def add(self, table: pa.Table) -> None:
        """Take the next rows."""
        for key, (nulls, values) in self._columns.items():
            column = table.column(key)
            nulls.update(_is_null(column).astype(np.uint8).tobytes())
            if pa.types.is_binary(column.type):
                for image in column:
                    data = image.as_buffer() if image.is_valid else _NOTHING
                    values.update(data.size.to_bytes(8, "little"))
                    values.update(data)
            else:
                numbers = np.ascontiguousarray(flat_numbers(column))
                values.update(numbers.astype(numbers.dtype.newbyteorder("<"), copy=False).tobytes())

    def hexdigest(self) -> str:
        """Return the hash of the rows so far."""
        total = hashlib.sha256()
        for key, (nulls, values) in self._columns.items():
            total.update(key.encode() + b"\0" + nulls.digest() + values.digest())
        return total.hexdigest()


def _is_null(column: pa.ChunkedArray | pa.Array) -> NDArray[np.bool_]:
    return column.is_null().to_numpy(zero_copy_only=False)
