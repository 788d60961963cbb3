"""Reads what Arrow trusts in a Parquet file but does not expose, in Thrift's compact protocol.

Only a page header says how large its page becomes when decompressed; the footer may be wrong about that.
Source: the specification of the compact protocol in the documentation of Apache Thrift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

# Field numbers in `parquet.thrift` of Apache Parquet: of a page header.
_TYPE, _UNCOMPRESSED, _PAGE_SIZE = 1, 2, 3
_TRUE, _FALSE = 1, 2
# Our headers have no statistics; those of other writers may contain long texts.
_USUAL_HEAD, _LONGEST_HEAD = 128, 1 << 20
# No list or struct in a header is nested deeper, and no list in a footer is longer.
_MOST_DEPTH = 16
_MOST_ITEMS = 1 << 20

DICTIONARY_PAGE = 2
"""The type of a dictionary page."""


def page_heads(read: Callable[[int, int], bytes], start: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the type of each page between two places in a file, and its size when decompressed [B].

    Args:
        read: Returns so many bytes from a place in the file, or fewer at its end.
        start: Where the first header begins.
        end: Where the last page ends.

    Raises:
        ValueError: There is something else between them.
    """
    while start < end:
        try:
            kind, uncompressed, size = _page_head(read(min(_USUAL_HEAD, end - start), start))
        except ValueError:
            kind, uncompressed, size = _page_head(read(min(_LONGEST_HEAD, end - start), start))
        start += size
        if start > end:
            raise ValueError("a page ends beyond its column")
        yield kind, uncompressed


def _page_head(data: bytes) -> tuple[int, int, int]:
    """Return a page's type, its size when decompressed, and that of header and page in the file [B]."""
    try:
        fields, after = thrift_struct(data, 0)
        kind, uncompressed, size = (int(fields[number]) for number in (_TYPE, _UNCOMPRESSED, _PAGE_SIZE))
    except (IndexError, KeyError, TypeError) as err:
        raise ValueError(f"not a page header: {err!r}") from err
    if size < 0 or uncompressed < 0:
        raise ValueError("a page of negative size")
    return kind, uncompressed, after + size


def thrift_struct(data: bytes, at: int, depth: int = 0) -> tuple[dict[int, Any], int]:
    """Read a struct; return its fields by number, and where it ends.

    Raises:
        ValueError: This is not such a struct.
        IndexError: It ends beyond the data.
    """
    fields: dict[int, Any] = {}
    number = 0
    while head := data[at]:
        at += 1
        if head >> 4:
            number += head >> 4
        else:
            number, at = _whole_number(data, at)
        kind = head & 0xF
        # The type of a boolean field is its value; only in a list does a boolean take a byte.
        fields[number], at = (kind == _TRUE, at) if kind in (_TRUE, _FALSE) else _thrift_value(data, at, kind, depth)
    return fields, at + 1


def _thrift_value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    if depth > _MOST_DEPTH:
        raise ValueError(f"values are nested more than {_MOST_DEPTH} levels deep")
    match kind:
        case 1 | 2 | 3:
            return data[at], at + 1
        case 4 | 5 | 6:
            return _whole_number(data, at)
        case 7:
            return None, at + 8
        case 8:
            size, at = _varint(data, at)
            if at + size > len(data):
                raise IndexError("a text ends beyond the data")
            return data[at : at + size], at + size
        case 9 | 10:
            head, at = data[at], at + 1
            size, at = (head >> 4, at) if head >> 4 < 15 else _varint(data, at)
            if size > _MOST_ITEMS:
                raise ValueError(f"a list of {size} items")
            values: list[Any] = []
            for _ in range(size):
                value, at = _thrift_value(data, at, head & 0xF, depth + 1)
                values.append(value)
            return values, at
        case 12:
            return thrift_struct(data, at, depth + 1)
        case other:
            raise ValueError(f"type {other} is not supported")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("a number of more than 64 bits")


def _whole_number(data: bytes, at: int) -> tuple[int, int]:
    folded, at = _varint(data, at)
    return (folded >> 1) ^ -(folded & 1), at
