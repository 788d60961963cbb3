"""Parquet files from a disk, which anybody may have written: what a file claims is checked before it is believed.

A file of a megabyte can claim, and even hold, columns of gigabytes. What is read of it is therefore bounded: by so much
as any file may have, or by so many times its own size as nothing that was recorded is ever compressed.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rcs.data.page_heads import DICTIONARY_PAGE, page_heads, thrift_struct
from rcs.errors import CorruptEpisode, DatasetError

UNREADABLE = (pa.ArrowException, OSError, UnicodeDecodeError, OverflowError)
"""What reading a damaged Parquet file raises beside `CorruptEpisode`; the third where a column's name is damaged."""

FREE_BYTES = 1 << 27
"""What a file may become when it is read, however small it is: a million rows that are all alike are 30 kB."""
MOST_GROWTH = 64
"""And how many times its size beyond that. Joint angles of an arm at rest, the smallest there are, make about 20."""

# A footer: some 100 bytes for each column and row group; of a dataset with cameras 256 rows are a group.
_MOST_FOOTER = 1 << 28
_MAGIC = b"PAR1"
_TAIL = 8
# Numbers of fields in `parquet.thrift` of Apache Parquet: of the footer, a row group, a column in it, its description,
# and the sizes in that.
_GROUPS, _COLUMNS, _META, _SIZES, _REPETITIONS, _DEFINITIONS = 4, 1, 3, 16, 2, 3
_MOST_SOUND = 1 << 17
_sound: set[tuple[int, int, int, int]] = set()
# What a dictionary may take: each of its values can stand for any number of rows.
_FREE_DICTIONARY, _MOST_DICTIONARY_GROWTH = 1 << 21, 4
# Images of so many rows are read at a time, so that a dictionary cannot become more than so many times itself.
_IMAGES_AT_A_TIME = 16


class ParquetSource:
    """An open Parquet file, and how much of it may be read."""

    def __init__(self, name: str, file: pq.ParquetFile, size: int, read: Callable[[int, int], bytes]) -> None:
        """Hold what `opened` opened.

        Args:
            name: The file's, for messages.
            file: The file as Arrow has it.
            size: Its bytes.
            read: Returns so many bytes from a place in it.
        """
        self.file = file
        self._name = name
        self._size = size
        self._read = read

    @property
    def rows(self) -> int:
        """How many rows it claims to have."""
        return self.file.metadata.num_rows

    def require(
        self, columns: Sequence[str] | None = None, groups: Iterable[int] | None = None, *, is_damaged: bool = False
    ) -> None:
        """Refuse to read what claims to be more than any recording is.

        Args:
            columns: The columns that will be read; None for all.
            groups: The row groups; None for all.
            is_damaged: Whether pages are only looked at up to the first whose head does not read.

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
                total += self._uncompressed(group.column(i), is_damaged=is_damaged)
            if total > bound:
                raise CorruptEpisode(f"{self._name} has {self._size} bytes, and claims {total} and more once read.")
        if rows < 0 or (groups is None and rows != about.num_rows):
            raise CorruptEpisode(f"{self._name} claims {about.num_rows} rows, and {rows} in its groups.")
        kept = [field for field in self.file.schema_arrow if columns is None or field.name in columns]
        if rows * sum(_width(field.type) for field in kept) > bound:
            raise CorruptEpisode(f"{self._name} has {self._size} bytes, and claims {rows} rows, more than it can have.")

    def table(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> pa.Table:
        """Read columns of some row groups.

        Args:
            columns: The columns; None for all.
            groups: The row groups; None for all.

        Raises:
            CorruptEpisode: It is more than any recording has, or the file contradicts itself.
            ArrowException, OSError: It does not read.
        """
        self.require(columns, groups)
        names = None if columns is None else list(columns)
        numbers = list(range(self.file.num_row_groups) if groups is None else groups)
        kept = [field for field in self.file.schema_arrow if names is None or field.name in names]
        if all(_is_fixed(field.type) for field in kept):
            return self.file.read_row_groups(numbers, columns=names, use_threads=False)
        return pa.Table.from_batches(self.batches(names, numbers), schema=pa.schema(kept))

    def batches(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Iterator[Any]:
        """Yield columns of some row groups, few rows at a time, up to as much as any recording has.

        Args:
            columns: The columns; None for all.
            groups: The row groups; None for all.

        Raises:
            CorruptEpisode: It is more than that.
            ArrowException, OSError: It does not read.
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
                raise CorruptEpisode(f"{self._name} has {self._size} bytes, and becomes {total} and more once read.")
            yield batch

    def _chosen(self, columns: Sequence[str] | None) -> Iterator[int]:
        """Yield the numbers of columns; names may have dots, as the paths of nested columns do."""
        schema, names = self.file.metadata.schema, self.file.schema_arrow.names
        for i in range(self.file.metadata.num_columns):
            path: str = schema.column(i).path
            name = path if path in names else next((name for name in names if path.startswith(f"{name}.")), path)
            if columns is None or name in columns:
                yield i

    def _uncompressed(self, chunk: Any, *, is_damaged: bool) -> int:
        """Return how many bytes a column of a row group becomes, by what stands before its pages."""
        what = f"Column {chunk.path_in_schema!r} of {self._name}"
        start = chunk.data_page_offset
        if chunk.has_dictionary_page and chunk.dictionary_page_offset:
            start = min(start, chunk.dictionary_page_offset)
        end = start + chunk.total_compressed_size
        if not 0 < start <= end <= self._size:
            raise CorruptEpisode(f"{what} is said to be outside of the file.")
        total = 0
        try:
            most = max(_FREE_DICTIONARY, _MOST_DICTIONARY_GROWTH * self._size)
            for head in page_heads(self._read, start, end):
                total += head.uncompressed
                if head.type == DICTIONARY_PAGE and head.uncompressed > most:
                    raise CorruptEpisode(f"{what} has a dictionary of {head.uncompressed} bytes.")
        except CorruptEpisode:
            raise
        except ValueError as err:
            if not is_damaged:
                raise CorruptEpisode(f"{what} does not read: {err}.") from err
        return total


@contextlib.contextmanager
def opened(source: Path | pa.Buffer, *, verify: bool = True, mapped: bool = False) -> Generator[ParquetSource]:
    """Open a Parquet file of an episode. What is read of it is first to be required of the source.

    Args:
        source: The file, or what is in it.
        verify: Whether the checksums of pages are checked.
        mapped: Whether the file is mapped into memory, which is faster; a sector that does not read then ends the
            process.

    Raises:
        CorruptEpisode: It is no whole Parquet file.
        ArrowException, OSError: It is none, or does not read.
    """
    if not isinstance(source, Path):
        _check_footer(source[-_TAIL:].to_pybytes() if source.size >= _TAIL else b"", source.size, "The mended file")
        with pq.ParquetFile(pa.BufferReader(source), page_checksum_verification=verify) as file:
            length = int.from_bytes(source[-_TAIL:].to_pybytes()[:4], "little")
            _check_levels(source[-_TAIL - length : -_TAIL].to_pybytes(), file, "The mended file")
            read: Callable[[int, int], bytes] = lambda count, at: source[at : at + count].to_pybytes()  # noqa: E731
            yield ParquetSource("The mended file", file, source.size, read)
        return
    with _opened(source, mapped=mapped, verify=verify) as opened_source:
        yield opened_source


@contextlib.contextmanager
def opened_of_others(path: Path) -> Generator[ParquetSource]:
    """Open a Parquet file of another writer. What is read of it is first to be required of the source.

    Args:
        path: The file.

    Raises:
        CorruptEpisode: It is no Parquet file, or what is read of it inside does not read.
    """
    try:
        with _opened(path, mapped=False, verify=False) as source:
            yield source
    except UNREADABLE as err:
        if isinstance(err, DatasetError):
            raise
        raise CorruptEpisode(f"{path} does not read: {err}.") from err


def bound_of(size: int) -> int:
    """Return how many bytes may become of a file of so many."""
    return max(FREE_BYTES, MOST_GROWTH * size)


@contextlib.contextmanager
def _opened(path: Path, *, mapped: bool, verify: bool) -> Generator[ParquetSource]:
    if not path.is_file():  # a pipe would never end
        raise CorruptEpisode(f"{path} does not read: it is missing or no file.")
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        about = os.fstat(fd)
        size = about.st_size
        tail = os.pread(fd, _TAIL, max(size - _TAIL, 0))
        _check_footer(tail, size, str(path))
        # Not `read_table`: that takes a folder named "seed=3" for a partition and adds a column.
        with pq.ParquetFile(path, memory_map=mapped, page_checksum_verification=verify) as file:
            # Once for each file and change of it: a footer of many row groups takes milliseconds.
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
        raise CorruptEpisode(f"{name} does not read: its {size} bytes are no whole Parquet file.")
    if length > _MOST_FOOTER:
        raise CorruptEpisode(f"{name} claims to describe itself in {length} bytes, which no recording needs.")


def _check_levels(footer: bytes, file: pq.ParquetFile, name: str) -> None:
    """Refuse counts of levels that do not go with the columns: Arrow would end the process where it looks at them."""
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
        raise CorruptEpisode(f"{name} does not read: its footer contradicts itself: {err!r}.") from err


def _is_fixed(kind: pa.DataType) -> bool:
    """Return whether each row takes the same memory, whatever is in it."""
    if pa.types.is_fixed_size_list(kind):
        return _is_fixed(kind.value_type)
    return pa.types.is_primitive(kind)


def _width(kind: pa.DataType) -> int:
    """Return the bytes that a row takes in memory at least."""
    if pa.types.is_fixed_size_list(kind):
        return kind.list_size * _width(kind.value_type)
    if pa.types.is_struct(kind):
        return sum(_width(kind.field(i).type) for i in range(kind.num_fields))
    try:
        return max(1, kind.bit_width // 8)
    except ValueError:  # of no fixed size: where it begins
        return 4
