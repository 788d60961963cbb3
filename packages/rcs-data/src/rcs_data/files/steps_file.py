"""`steps.parquet`: the numbers of an episode, a row per step, without compression, so that any Parquet reader has them.

The column `episode` has the id, `step` counts from 0, and an image is its number in `frames.zip`. Null says that there
is nothing: no action before a reset, no image yet, no time measured. A value that is held, or an image that is shown
again, is there in every row; dictionary encoding has it take no space.

A checksum of Parquet covers what a page has, not how it is to be read, nor the footer. So the footer also has the
CRC-32 of each column's values, which are compared whenever they are read.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from isal.isal_zlib import crc32
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import HashedFile
from rcs_data.files.feature import EPISODE, STEP
from rcs_data.files.info import DatasetInfo

_UNREADABLE = (pa.ArrowException, OSError, UnicodeDecodeError, OverflowError)
# Most rows per row group, and most memory that one takes [B]; fixed by the columns, so that the bytes do not depend on
# how the rows arrive.
_MOST_ROWS, _MOST_BYTES = 16384, 1 << 25
# Key of the checksums in the footer: of each group, those of the columns of `DatasetInfo.stream_schema`.
_CHECKSUMS, _DIGITS = b"crc32", 8


class StepsWriter:
    """Writes the file group by group, hashed on the way."""

    def __init__(self, path: Path, info: DatasetInfo, episode_id: str) -> None:
        """Start the file, replacing any that is there.

        Args:
            path: The file.
            info: The facts that the dataset's episodes share.
            episode_id: The episode.
        """
        self.name = path.name
        self.rows = 0
        self._id = episode_id
        self._checksums = ""
        self._waiting: list[pa.Table] = []
        self._held = 0
        self._group = max(1, min(_MOST_ROWS, _MOST_BYTES // sum(map(_width, info.steps_schema.types[1:]))))
        coded: Any = [EPISODE]  # and values that last
        coded += [f.key if f.shape == () else f"{f.key}.list.element" for f in info.features if f.encoding == "held"]
        self._file = HashedFile(path)
        self._writer = pq.ParquetWriter(
            self._file,
            info.steps_schema,
            use_dictionary=coded,
            write_statistics=False,
            compression="none",
            store_schema=False,  # lists of any length: Arrow before version 26 cannot read fixed ones that are null
        )

    def __enter__(self) -> StepsWriter:
        return self

    def __exit__(self, *_: object) -> None:
        # In this order: after a failure the Parquet writer still writes its footer, which a closed file drops.
        self._file.close()
        self._writer.close()

    def write(self, rows: pa.Table) -> None:
        """Append rows with the numbers of images; what they were read from, images and all, is not kept."""
        rows = rows.take(pa.array(np.arange(rows.num_rows)))
        ids = pa.array([self._id] * rows.num_rows, pa.string())
        steps = pa.array(np.arange(self.rows, self.rows + rows.num_rows))
        rows = rows.add_column(0, STEP, steps).add_column(0, EPISODE, ids)
        self.rows += rows.num_rows
        while self._held + rows.num_rows >= self._group:
            head = self._group - self._held
            self._write_group(rows.slice(0, head))
            rows = rows.slice(head)
        if rows.num_rows:
            self._waiting.append(rows)
            self._held += rows.num_rows

    def complete(self) -> str:
        """Write what is left and the footer, bring the file to the disk and return its SHA-256."""
        if self._waiting:
            self._write_group()
        self._writer.add_key_value_metadata({_CHECKSUMS: self._checksums})
        self._writer.close()
        return self._file.complete()

    def _write_group(self, *last: pa.Table) -> None:
        group = pa.concat_tables([*self._waiting, *last]).combine_chunks()
        self._writer.write_table(group, row_group_size=group.num_rows)
        self._checksums += "".join(_checksum(*_values(column.combine_chunks())) for column in group.columns[2:])
        self._waiting, self._held = [], 0


def read_steps(path: Path, info: DatasetInfo, length: int, columns: Sequence[str]) -> pa.Table:
    """Return columns of all rows, lists of numbers as lists of fixed length.

    Args:
        path: The file.
        info: The facts that the dataset's episodes share.
        length: Rows of the episode.
        columns: Names of `info.stream_schema`.

    Raises:
        CorruptEpisode: The file is missing, damaged, or not that of such an episode.
    """
    with _opened(path, info, length, mapped=True) as file:
        return pa.concat_tables(_group(path, file, group, info, columns) for group in range(file.num_row_groups))


def step_groups(path: Path, info: DatasetInfo, length: int) -> Iterator[pa.Table]:
    """Yield all rows as `read_steps` has them, a group at a time; the file is read, not mapped.

    Raises:
        CorruptEpisode: The file is missing, damaged, or not that of such an episode.
    """
    with _opened(path, info, length, mapped=False) as file:
        for group in range(file.num_row_groups):
            yield _group(path, file, group, info, info.stream_schema.names)


@contextlib.contextmanager
def _opened(path: Path, info: DatasetInfo, length: int, *, mapped: bool) -> Generator[Any]:
    if not path.is_file():  # opening a pipe would never end
        raise CorruptEpisode(f"Cannot read {path}: it is missing or not a file.")
    try:
        # Not `read_table`, which takes a folder named "seed=3" for a partition and adds a column.
        # Absolute: Arrow takes a relative path such as "run:1/steps.parquet" for an address.
        with pq.ParquetFile(path.absolute(), memory_map=mapped) as file:
            if file.metadata.num_rows != length:
                raise CorruptEpisode(f"{path} has {file.metadata.num_rows} rows; expected {length}.")
            if file.schema_arrow.names != info.steps_schema.names:
                raise CorruptEpisode(f"The columns of {path} differ from the dataset's.")
            checksums = (file.metadata.metadata or {}).get(_CHECKSUMS, b"")
            if not checksums or len(checksums) != _DIGITS * len(info.stream_schema) * file.num_row_groups:
                raise CorruptEpisode(f"The footer of {path} is not what was written.")
            yield file
    except CorruptEpisode:
        raise
    except _UNREADABLE as err:
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err


def _group(path: Path, file: Any, number: int, info: DatasetInfo, columns: Sequence[str]) -> pa.Table:
    """Return columns of a group with the types of the dataset.

    Raises:
        CorruptEpisode: A column is not what was written, or of another type.
    """
    rows = file.read_row_group(number, columns=list(columns), use_threads=False)
    names, checksums = info.stream_schema.names, file.metadata.metadata[_CHECKSUMS].decode()
    schema = pa.schema([info.steps_schema.field(name) for name in rows.column_names])
    arrays: list[pa.Array] = []
    try:
        for name, column, kind in zip(rows.column_names, rows.columns, schema.types, strict=True):
            array = column.combine_chunks()
            values, is_null = _values(array)
            place = _DIGITS * (number * len(names) + names.index(name))
            if _checksum(values, is_null) != checksums[place : place + _DIGITS]:
                raise CorruptEpisode(f"The column {name!r} of {path} is not what was written.")
            is_list = pa.types.is_fixed_size_list(kind)
            arrays.append(_lists(values, is_null, kind.list_size) if is_list else array)
        return pa.Table.from_arrays(arrays, schema=schema)
    except CorruptEpisode:
        raise
    except (pa.ArrowException, ValueError, TypeError) as err:
        raise CorruptEpisode(f"The columns of {path} differ from the dataset's: {err}.") from err


def _values(column: pa.Array) -> tuple[pa.Array, NDArray[np.bool_] | None]:
    """Return the values that are there, those of lists one after the other, and which rows have none, if any."""
    is_null = column.is_null().to_numpy(zero_copy_only=False) if column.null_count else None
    if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        return column.flatten(), is_null
    return column if is_null is None else column.drop_null(), is_null


def _checksum(values: pa.Array, is_null: NDArray[np.bool_] | None) -> str:
    start = 0 if is_null is None else crc32(is_null)
    return f"{crc32(np.ascontiguousarray(values.to_numpy(zero_copy_only=False)), start):08x}"


def _lists(values: pa.Array, is_null: NDArray[np.bool_] | None, size: int) -> pa.Array:
    if is_null is None:
        return pa.FixedSizeListArray.from_arrays(values, size)
    found = values.to_numpy(zero_copy_only=False)
    numbers = np.zeros((len(is_null), size), found.dtype)
    numbers[~is_null] = found.reshape(-1, size)
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers.reshape(-1)), size, mask=pa.array(is_null))


def _width(kind: pa.DataType) -> int:
    return kind.list_size * _width(kind.value_type) if pa.types.is_fixed_size_list(kind) else -(-kind.bit_width // 8)
