"""Finds and restores a single changed byte of a file; a hash confirms that the result is right.

A page of a Parquet file has a CRC-32. Its difference from the CRC of the present bytes depends on which byte changed
and how, so running the CRC's register backwards over the page finds the place. Parts without a CRC, such as
descriptions and headers, are small enough to try every bit.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from rcs_data.durable import is_sealed, unsealed
from rcs_data.errors import CorruptEpisode
from rcs_data.json_file import MOST_DEPTH
from rcs_data.page_heads import page_head, thrift_struct

# Most bytes to try bit by bit: 8192 bytes take a second or two.
_MOST_BYTES = 8192
# Most bytes to hash for one file: some seconds.
_MOST_HASHED = 4 << 30
_MAGIC = 4
_TAIL = 8
# Longer than any of our page headers, which have no statistics.
_PAGE_HEAD = 48
# Field numbers in `parquet.thrift` of Apache Parquet: of the footer, a row group, a column in it, its description.
_GROUPS, _COLUMNS, _META, _SIZE, _START = 4, 1, 3, 7, 9


def mended_json(data: bytes, path: Path) -> dict[str, Any] | None:
    """Return the values of sealed JSON before one bit of it changed; None if that does not explain the damage.

    Args:
        data: The bytes of the file.
        path: The file.
    """
    if len(data) > _MOST_BYTES or _nesting(data) > 2 * MOST_DEPTH:
        return None
    for at in range(8 * len(data)):
        changed = _changed(data, at // 8, 1 << at % 8)
        try:
            if not is_sealed(changed):  # the faster test
                continue
            return unsealed(changed, path)
        except CorruptEpisode:
            continue
    return None


def _nesting(data: bytes) -> int:
    """Return how deep brackets are nested, including those in texts."""
    return max(accumulate((byte in b"[{") - (byte in b"]}") for byte in data), default=0)


def mended_parquet(data: bytes, sha256: str) -> bytes | None:
    """Return a Parquet file before one byte of a page, or one bit elsewhere, changed; None if more is damaged.

    Args:
        data: The bytes of the file.
        sha256: Their original hash.
    """

    def is_right(candidate: bytes) -> bool:
        return hashlib.sha256(candidate).hexdigest() == sha256

    footer = _footer_start(data)
    heads: list[int] = []
    for start, end in _chunks(data):
        pages = list(_pages(data, start, end))
        heads += [at for page in pages for at in range(page.head, page.start)]
        broken = [page for page in pages if zlib.crc32(data[page.start : page.end]) != page.crc]
        for page in broken:
            for candidate in (*_with_right_page(data, page), *_with_right_head(data, page.head, end)):
                if is_right(candidate):
                    return candidate
        read = pages[-1].end if pages else start
        if read != end:  # the next header is damaged
            for candidate in _with_right_head(data, read, end):
                if is_right(candidate):
                    return candidate
    tail = max(len(data) - _TAIL, 0)
    # The length of the footer first, since it locates the footer.
    places = [*range(tail, len(data)), *range(min(footer, tail), tail)]
    return _try_bits(data, sha256, [*places, *sorted({*range(min(_MAGIC, len(data))), *heads}, reverse=True)])


@dataclass(frozen=True)
class _Page:
    """Where a page's header and data begin, where the data end, and their CRC."""

    head: int
    start: int
    end: int
    crc: int


def _chunks(data: bytes) -> list[tuple[int, int]]:
    """Return where the columns of each row group start and end according to the footer; nothing if it is damaged.

    Arrow is not used, since it ends the process if some fields of the footer contradict each other.
    """
    try:
        footer, _ = thrift_struct(data, len(data) - _TAIL - int.from_bytes(data[-_TAIL:-_MAGIC], "little"))
        columns = [column[_META] for group in footer[_GROUPS] for column in group[_COLUMNS]]
        places = [(column[_START], column[_START] + column[_SIZE]) for column in columns]
    except (IndexError, KeyError, TypeError, ValueError, RecursionError):
        return []
    return [(start, end) for start, end in places if 0 <= start <= end <= len(data)]


def _pages(data: bytes | bytearray, start: int, end: int) -> Iterator[_Page]:
    """Yield the pages between two places, up to the first unreadable header."""
    while start < end:
        try:
            head = page_head(data, start)
        except ValueError:
            return
        page_end = head.start + head.size
        if head.crc is None or page_end > end:
            return
        yield _Page(head=start, start=head.start, end=page_end, crc=head.crc)
        start = page_end


def _with_right_page(data: bytes, page: _Page) -> Iterator[bytes]:
    """Yield the file with one byte of a page changed so that its CRC is right, for each candidate."""
    register = zlib.crc32(data[page.start : page.end]) ^ page.crc
    # The effect of one byte on an empty register: zlib's CRC without its first and last inversion.
    table = [zlib.crc32(bytes([byte])) ^ zlib.crc32(b"\0") for byte in range(256)]
    of_last_byte = {value: byte for byte, value in enumerate(table) if byte}
    by_top = {value >> 24: byte for byte, value in enumerate(table)}
    for at in range(page.end - 1, page.start - 1, -1):
        if register in of_last_byte:
            yield _changed(data, at, of_last_byte[register])
        byte = by_top[register >> 24]
        register = ((register ^ table[byte]) << 8 | byte) & 0xFFFFFFFF


def _with_right_head(data: bytes, start: int, end: int) -> Iterator[bytes]:
    """Yield the file with one bit of the page header at `start` changed so that pages fill it up to `end`."""
    tried = bytearray(data)
    for at in range(start, min(start + _PAGE_HEAD, end)):
        for bit in range(8):
            tried[at] ^= 1 << bit
            pages = list(_pages(tried, start, end))
            if pages and pages[-1].end == end and zlib.crc32(tried[pages[0].start : pages[0].end]) == pages[0].crc:
                yield bytes(tried)
            tried[at] ^= 1 << bit


def _footer_start(data: bytes) -> int:
    """Return where the footer begins according to its length, within bounds."""
    length = int.from_bytes(data[-_TAIL:-_MAGIC], "little")
    return max(len(data) - _TAIL - min(length, 8 * _MOST_BYTES), 0)


def _try_bits(data: bytes, sha256: str, places: list[int]) -> bytes | None:
    """Change each bit in some places, one at a time, until the hash is right."""
    hashed = 0
    start, prefix = -1, hashlib.sha256()
    for place in places:
        hashed += 8 * (len(data) - place)
        if hashed > _MOST_HASHED:
            return None
        if place < start or start < 0:
            start, prefix = 0, hashlib.sha256()
        prefix.update(data[start:place])
        start = place
        rest = data[place + 1 :]
        for bit in range(8):
            whole = prefix.copy()
            whole.update(bytes([data[place] ^ 1 << bit]))
            whole.update(rest)
            if whole.hexdigest() == sha256:
                return _changed(data, place, 1 << bit)
    return None


def _changed(data: bytes, at: int, bits: int) -> bytes:
    return data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]
