"""The content of episodes: a hash over all columns except times and flags, and a comparison."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from rcs_data.files.info import DatasetInfo

if TYPE_CHECKING:
    from rcs_data.read.episode_record import EpisodeRecord

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


def compare_steps(a: EpisodeRecord, b: EpisodeRecord, keys: Sequence[str] | None = None) -> list[str]:
    """Describe how the rows of two episodes differ, one line per column; times and flags are not compared.

    Args:
        a: An episode.
        b: Another one.
        keys: The columns to compare; None for all.
    """
    lines: list[str] = []
    known = [[f.key for f in episode.info.features if not f.is_circumstance] for episode in (a, b)]
    if keys is None and known[0] != known[1]:
        lines.append(f"columns: {known[0]} and {known[1]}")
    if a.length != b.length:
        lines.append(f"rows: {a.length} and {b.length}")
    first = 0
    different: set[str] = set()
    for left in a.rows(stop=min(a.length, b.length)):
        right = pa.concat_tables(b.rows(first, first + left.num_rows))
        for key in (key for key in known[0] if key in known[1] and (keys is None or key in keys)):
            pair = left.column(key).combine_chunks(), right.column(key).combine_chunks()
            row = _first_difference(*pair) if pair[0].type == pair[1].type else None
            if key not in different and (row is not None or pair[0].type != pair[1].type):
                types = f"{pair[0].type} and {pair[1].type}"
                lines.append(f"{key}: {types if row is None else f'first difference in row {first + row}'}")
                different.add(key)
        first += left.num_rows
    return lines


def steps_equal(a: EpisodeRecord, b: EpisodeRecord) -> bool:
    """Return whether the rows of two episodes are equal bit for bit, except for times and flags."""
    return not compare_steps(a, b)


def _first_difference(a: pa.Array, b: pa.Array) -> int | None:
    is_different = _is_null(a) != _is_null(b)
    if pa.types.is_binary(a.type):
        is_same = pc.call_function("equal", [a, b]).fill_null(True)  # that both have a value was checked above
        is_different |= ~is_same.to_numpy(zero_copy_only=False)
    elif len(a):
        # Bits, not values: NaN is NaN here, and 0 is not -0.
        bits = [np.ascontiguousarray(flat_numbers(array)).view(np.uint8).reshape(len(a), -1) for array in (a, b)]
        is_different |= (bits[0] != bits[1]).any(axis=1)
    rows = np.flatnonzero(is_different)
    return int(rows[0]) if len(rows) else None


def _is_null(column: pa.ChunkedArray | pa.Array) -> NDArray[np.bool_]:
    return (
        column.is_null().to_numpy(zero_copy_only=False) if isinstance(column, pa.Array) else column.is_null().to_numpy()
    )
