"""Reads untrusted Parquet files: what a file claims is checked before it is used.

A file of a megabyte can claim, and even hold, columns of gigabytes. What is read of it is therefore bounded by an
absolute size, or by a multiple of the file's size that no recording reaches.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.page_heads import DICTIONARY_PAGE, page_heads, thrift_struct

UNREADABLE = (pa.ArrowException, OSError, UnicodeDecodeError, OverflowError)
"""Raised when a damaged Parquet file is read, besides `CorruptEpisode`; the third if a column's name is damaged."""

FREE_BYTES = 1 << 27
"""Size that any file may have in memory, however small it is [B]: a million equal rows are 30 kB on disk."""
MOST_GROWTH = 64
"""Multiple of its size that a larger file may have in memory. An arm at rest, the best case, reaches about 20."""

# A footer has some 100 bytes per column and row group; with cameras, a group has 256 rows.
_MOST_FOOTER = 1 << 28
_MAGIC = b"PAR1"
_TAIL = 8
# Field numbers in `parquet.thrift` of Apache Parquet: of the footer, a row group, a column in it, its description, and
# the sizes in that.
_GROUPS, _COLUMNS, _META, _SIZES, _REPETITIONS, _DEFINITIONS = 4, 1, 3, 16, 2, 3
_MOST_SOUND = 1 << 17
_sound: set[tuple[int, int, int, int]] = set()
# Largest dictionary [B]: each of its values can stand for any number of rows.
_FREE_DICTIONARY, _MOST_DICTIONARY_GROWTH = 1 << 21, 4
# Rows of images read at a time, which bounds how often a dictionary is repeated.
_IMAGES_AT_A_TIME = 16


class ParquetSource:
    """An open Parquet file that limits how much is read of it; `opened` yields one."""

    def __init__(self, name: str, file: pq.ParquetFile, size: int, read: Callable[[int, int], bytes]) -> None:
        self.file = file
        self.schema: pa.Schema = file.schema_arrow
        self._name = name
        self._size = size
        self._read = read

    @property
    def rows(self) -> int:
        """Rows that it claims to have."""
        return self.file.metadata.num_rows

    def require(self, columns: Sequence[str] | None = None, groups: Iterable[int] | None = None) -> None:
        """Refuse to read columns of row groups, None for all, that claim to be larger than any recording.

        Raises:
            CorruptEpisode: It is too much, or the file contradicts itself.
        """
        about = self.file.metadata
        bound = bound_of(self._size)
        chosen = list(self._chosen(columns))
        numbers = range(about.num_row_groups) if groups is None else groups
        rows = total = 0
        for group in map(about.row_group, numbers):
            rows += group.num_rows
            for i in chosen:
                total += self._uncompressed(group.column(i))
            if total > bound:
                raise CorruptEpisode(f"{self._name} has {self._size} bytes and claims at least {total} once read.")
        if rows < 0 or (groups is None and rows != about.num_rows):
            raise CorruptEpisode(f"{self._name} claims {about.num_rows} rows in all, but {rows} in its groups.")
        kept = [field for field in self.schema if columns is None or field.name in columns]
        if rows * sum(_width(field.type) for field in kept) > bound:
            raise CorruptEpisode(f"{self._name} has {self._size} bytes and claims {rows} rows, more than fit.")

    def table(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> pa.Table:
        """Read columns of some row groups, None for all.

        Raises:
            CorruptEpisode: They are larger than any recording, or the file contradicts itself.
            ArrowException, OSError: The file cannot be read.
        """
        self.require(columns, groups)
        names = None if columns is None else list(columns)
        numbers = list(range(self.file.num_row_groups) if groups is None else groups)
        kept = [field for field in self.schema if names is None or field.name in names]
        if all(_is_fixed(field.type) for field in kept):
            try:
                return self.file.read_row_groups(numbers, columns=names, use_threads=False)
            except pa.ArrowInvalid as err:
                if "lists to be of size" not in str(err):
                    raise
                return self._read_as_lists(names, numbers, pa.schema(kept))
        return pa.Table.from_batches(self.batches(names, numbers), schema=pa.schema(kept))

    def batches(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Iterator[Any]:
        """Yield columns of some row groups, None for all, a few rows at a time, up to the size limit.

        Raises:
            CorruptEpisode: They are larger than that.
            ArrowException, OSError: The file cannot be read.
        """
        total = 0
        for batch in self.file.iter_batches(
            _IMAGES_AT_A_TIME,
            row_groups=None if groups is None else list(groups),
            columns=None if columns is None else list(columns),
            use_threads=False,
        ):
            total += batch.nbytes
            if total > bound_of(self._size):
                raise CorruptEpisode(f"{self._name} has {self._size} bytes and becomes at least {total} once read.")
            yield batch

    def _read_as_lists(self, names: list[str] | None, groups: list[int], schema: pa.Schema) -> pa.Table:
        """Read lists of fixed length that may be null, which Arrow before version 26 writes and cannot read.

        Without Arrow's own description of the columns in its footer, the file has lists of any length.
        """
        data = bytearray(self._read(self._size, 0))
        begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        data[begin:] = data[begin:].replace(b"ARROW:schema", b"arrow:schema")
        source = ParquetSource(self._name, pq.ParquetFile(pa.BufferReader(data)), self._size, self._read)
        parts = [
            pa.Table.from_arrays([_fixed(batch.column(field.name), field.type) for field in schema], schema=schema)
            for batch in source.batches(names, groups)
        ]
        return pa.concat_tables([schema.empty_table(), *parts]).combine_chunks()

    def _chosen(self, columns: Sequence[str] | None) -> Iterator[int]:
        """Yield the numbers of columns; names may contain dots, as paths of nested columns do."""
        schema, names = self.file.metadata.schema, self.schema.names
        for i in range(self.file.metadata.num_columns):
            path: str = schema.column(i).path
            name = path if path in names else next((name for name in names if path.startswith(f"{name}.")), path)
            if columns is None or name in columns:
                yield i

    def _uncompressed(self, chunk: Any) -> int:
        """Return the size that a column of a row group has in memory [B], according to its page headers."""
        what = f"Column {chunk.path_in_schema!r} of {self._name}"
        start = chunk.data_page_offset
        if chunk.has_dictionary_page and chunk.dictionary_page_offset:
            start = min(start, chunk.dictionary_page_offset)
        end = start + chunk.total_compressed_size
        if not 0 < start <= end <= self._size:
            raise CorruptEpisode(f"{what} claims to be outside of the file.")
        total = 0
        try:
            most = max(_FREE_DICTIONARY, _MOST_DICTIONARY_GROWTH * self._size)
            for kind, uncompressed in page_heads(self._read, start, end):
                total += uncompressed
                if kind == DICTIONARY_PAGE and uncompressed > most:
                    raise CorruptEpisode(f"{what} has a dictionary of {uncompressed} bytes.")
        except CorruptEpisode:
            raise
        except ValueError as err:
            raise CorruptEpisode(f"Cannot read {what}: {err}.") from err
        return total


@contextlib.contextmanager
def opened_of_others(path: Path) -> Generator[ParquetSource]:
    """Open a Parquet file of another writer. Call `require` before reading.

    Raises:
        CorruptEpisode: It is not a Parquet file, or cannot be read inside of the block.
    """
    try:
        with opened(path, verify=False) as source:
            yield source
    except UNREADABLE as err:
        if isinstance(err, DatasetError):
            raise
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err


def bound_of(size: int) -> int:
    """Return how many bytes a file may have in memory, given its size."""
    return max(FREE_BYTES, MOST_GROWTH * size)


@contextlib.contextmanager
def opened(path: Path, *, mapped: bool = False, verify: bool = True) -> Generator[ParquetSource]:
    """Open a Parquet file of an episode. Call `require` before reading.

    Args:
        path: The file.
        mapped: Whether the file is mapped into memory, which is faster, but an unreadable sector then ends the process.
        verify: Whether the checksums of pages are checked.

    Raises:
        CorruptEpisode: It is not a complete Parquet file.
        ArrowException, OSError: It cannot be read.
    """
    if not path.is_file():  # reading a pipe would never end
        raise CorruptEpisode(f"Cannot read {path}: it is missing or not a file.")
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        about = os.fstat(fd)
        size = about.st_size
        tail = os.pread(fd, _TAIL, max(size - _TAIL, 0))
        _check_footer(tail, size, str(path))
        # Not `read_table`, which takes a folder named "seed=3" for a partition and adds a column.
        with pq.ParquetFile(path, memory_map=mapped, page_checksum_verification=verify) as file:
            # Cached per file and change of it: a footer with many row groups takes milliseconds.
            version = (about.st_dev, about.st_ino, size, about.st_mtime_ns)
            if version not in _sound:
                length = int.from_bytes(tail[:4], "little")
                _check_levels(os.pread(fd, length, size - _TAIL - length), file, str(path))
                if len(_sound) >= _MOST_SOUND:
                    _sound.clear()
                _sound.add(version)
            yield ParquetSource(str(path), file, size, lambda count, at: os.pread(fd, count, at))
    finally:
        os.close(fd)


def _check_footer(tail: bytes, size: int, name: str) -> None:
    length = int.from_bytes(tail[:4], "little")
    if len(tail) < _TAIL or tail[4:] != _MAGIC or length + _TAIL > size:
        raise CorruptEpisode(f"Cannot read {name}: its {size} bytes are not a complete Parquet file.")
    if length > _MOST_FOOTER:
        raise CorruptEpisode(f"{name} claims a footer of {length} bytes, more than any recording needs.")


def _check_levels(footer: bytes, file: pq.ParquetFile, name: str) -> None:
    """Refuse counts of levels that do not fit the columns: Arrow would end the process when it reads them."""
    schema = file.metadata.schema
    try:
        fields, _ = thrift_struct(footer, 0)
        for group in fields.get(_GROUPS, ()):
            if len(group[_COLUMNS]) != file.metadata.num_columns:
                raise ValueError("a row group has other columns")
            for i, chunk in enumerate(group[_COLUMNS]):
                sizes = chunk[_META].get(_SIZES)
                if sizes is None:
                    continue
                column = schema.column(i)
                for field, level in (
                    (_REPETITIONS, column.max_repetition_level),
                    (_DEFINITIONS, column.max_definition_level),
                ):
                    if len(sizes.get(field, ())) not in (0, level + 1):
                        raise ValueError(f"column {column.path!r} counts levels that it does not have")
    except (IndexError, KeyError, TypeError, AttributeError, ValueError) as err:
        raise CorruptEpisode(f"Cannot read {name}: its footer contradicts itself: {err!r}.") from err


def _fixed(column: pa.Array, kind: pa.DataType) -> pa.Array:
    """Return lists as lists of fixed length; other columns stay.

    Raises:
        ArrowInvalid: A list has another length.
    """
    # A null has no numbers, and Arrow casts only lists that have all; few rows are converted at a time.
    return pa.array(column.to_pylist(), kind) if column.null_count else column.cast(kind)


def _is_fixed(kind: pa.DataType) -> bool:
    """Return whether every row takes the same memory, whatever its value."""
    if pa.types.is_fixed_size_list(kind):
        return _is_fixed(kind.value_type)
    return pa.types.is_primitive(kind)


def _width(kind: pa.DataType) -> int:
    """Return the least memory that a row takes [B]."""
    if pa.types.is_fixed_size_list(kind):
        return kind.list_size * _width(kind.value_type)
    if pa.types.is_struct(kind):
        return sum(_width(kind.field(i).type) for i in range(kind.num_fields))
    try:
        return max(1, kind.bit_width // 8)
    except ValueError:  # of variable size: its offset
        return 4
