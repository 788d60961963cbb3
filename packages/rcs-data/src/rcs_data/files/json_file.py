"""Reads JSON: an object per file, or per line, with finite numbers; and checks what is in it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from rcs_data.errors import CorruptEpisode


def read_json(path: Path) -> dict[str, Any]:
    """Read a file with one JSON object.

    Raises:
        CorruptEpisode: It is missing, or not a JSON object.
    """
    return parsed_json(read_bytes(path), path)


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """Read a file with a JSON object per line.

    Raises:
        CorruptEpisode: It is missing, or a line is not a JSON object.
    """
    # Only at "\n": `splitlines` also splits at Unicode line separators within a text.
    return [parsed_json(line, path) for line in read_bytes(path).split(b"\n") if line.strip()]


def read_bytes(path: Path) -> bytes:
    """Read a file.

    Raises:
        CorruptEpisode: It is missing, not a file, or cannot be read.
    """
    if not path.is_file():  # reading a pipe would never end
        raise CorruptEpisode(f"{path} is missing or not a file.")
    try:
        return path.read_bytes()
    except OSError as err:
        raise CorruptEpisode(f"Cannot read {path}: {err.strerror or err}.") from err


def parsed_json(data: bytes | str, path: Path | str) -> dict[str, Any]:
    """Return the JSON object in some text.

    Args:
        data: The text, bytes as UTF-8.
        path: The file, for the message.

    Raises:
        CorruptEpisode: It is not a JSON object, or has a number that is none.
    """
    try:
        return _DECODER.decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err


def leaves(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by their paths, with `.` between names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            found |= leaves(value, f"{above}{name}.")
        else:
            found[f"{above}{name}"] = value
    return found


def check_fields(values: Any, kind: Any) -> None:
    """Check JSON values against a `TypedDict`, or a type made of such; fields that it does not name are ignored.

    Raises:
        msgspec.ValidationError: A field is missing or not valid; the message names it.
    """
    _look_at(kind)
    msgspec.convert(values, kind)


@cache
def _look_at(kind: Any) -> None:
    """Let msgspec take a type apart; its process crashes where two threads do so at a time (msgspec 0.22)."""
    with _LOOKING:
        msgspec.json.Decoder(kind)


_LOOKING = threading.Lock()
_DECODER = msgspec.json.Decoder(dict[str, Any])
