"""Reads what Arrow trusts in the heads of an IPC file's batches: a compressed one may become any size in memory.

Source: `File.fbs` and `Message.fbs` of Apache Arrow's format, and the layout of FlatBuffers' tables.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

from rcs_data.errors import CorruptEpisode

_MAGIC = b"ARROW1"
_LONGEST_FOOTER, _LONGEST_HEAD = 1 << 26, 1 << 20
# Numbers of fields: of a footer, of a message, of a record batch.
_DICTIONARIES, _BATCHES, _HEADER, _COMPRESSION = 2, 3, 2, 3
# A block of the footer: where a message begins, the length of its head, padding, the length of its body.
_BLOCK = struct.Struct("<qixxxxq")


class BatchHeads:
    """Where the batches of an Arrow IPC file are, and what their heads say."""

    def __init__(self, path: Path) -> None:
        """Read the footer.

        Raises:
            CorruptEpisode: It is not the footer of such a file, or the file has dictionaries.
            OSError: The file cannot be read.
        """
        self._path = path
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            tail = _at(file.fileno(), max(size - 10, 0), 10)
            length = int.from_bytes(tail[:4], "little", signed=True)
            if tail[4:] != _MAGIC or not 0 < length <= min(size - 10, _LONGEST_FOOTER):
                raise CorruptEpisode(f"Cannot read {path}: it is not an Arrow file.")
            footer = _at(file.fileno(), size - 10 - length, length)
        try:
            table = _table(footer, 0)
            dictionaries, batches = _field(footer, table, _DICTIONARIES), _field(footer, table, _BATCHES)
            if dictionaries and _number(footer, _table(footer, dictionaries), "<I"):
                raise CorruptEpisode(f"Cannot read {path}: it has dictionaries.")
            self._blocks: list[tuple[int, int, int]] = []
            if batches:
                vector = _table(footer, batches)
                end = vector + 4 + _BLOCK.size * _number(footer, vector, "<I")
                self._blocks = list(_BLOCK.iter_unpack(footer[vector + 4 : end]))
        except struct.error as err:
            raise CorruptEpisode(f"Cannot read {path}: its footer contradicts itself.") from err

    def refuse_compressed(self, number: int) -> None:
        """Raise if a batch is compressed.

        Raises:
            CorruptEpisode: It is, or its head cannot be read.
            OSError: The file cannot be read.
        """
        try:
            start, length, _ = self._blocks[number]
            if start < 0 or not 8 < length <= _LONGEST_HEAD:
                raise CorruptEpisode(f"Cannot read {self._path}: batch {number} has no head.")
            with self._path.open("rb") as file:
                head = _at(file.fileno(), start, length)
            # A head begins with a mark and its length, four bytes each.
            message = _table(head, 8)
            header = _field(head, message, _HEADER)
            is_compressed = header != 0 and _field(head, _table(head, header), _COMPRESSION) != 0
        except (struct.error, IndexError) as err:
            raise CorruptEpisode(f"Cannot read {self._path}: the head of batch {number} contradicts itself.") from err
        if is_compressed:
            raise CorruptEpisode(f"Cannot read {self._path}: batch {number} is compressed, as no recording is.")


def _at(fd: int, place: int, length: int) -> bytes:
    return os.pread(fd, length, place)


def _number(data: bytes, place: int, kind: str) -> int:
    if place < 0:
        raise struct.error("before the data")
    return struct.unpack_from(kind, data, place)[0]


def _table(data: bytes, place: int) -> int:
    """Return where the table or vector begins that a place refers to."""
    return place + _number(data, place, "<I")


def _field(data: bytes, table: int, number: int) -> int:
    """Return where a field of a table is; 0 if it has none."""
    names = table - _number(data, table, "<i")
    entry = 4 + 2 * number
    offset = _number(data, names + entry, "<H") if entry < _number(data, names, "<H") else 0
    return table + offset if offset else 0
