"""Reads untrusted JSON: of bounded size and depth, with finite numbers and valid text."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, NoReturn

from rcs_data.errors import CorruptEpisode
from rcs_data.text import is_storable

MOST_BYTES = 1 << 26
"""Largest file that is read [B]. The `dataset.json` of 50 000 episodes grows by some 0.8 MB with each edit."""
MOST_DEPTH = 64
"""Deepest nesting: code that walks the values is recursive, and Python ends that at 1000 levels."""
# Digits of a whole number. No file needs more, and the time to parse them grows with their square.
_MOST_DIGITS = 40


def read_json(path: Path) -> dict[str, Any]:
    """Read a file with one JSON object.

    Raises:
        CorruptEpisode: It is missing, not a JSON object, or larger or deeper than any of a dataset.
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
    """Read a file of limited size.

    Raises:
        CorruptEpisode: It is missing, not a file, or too large.
    """
    try:
        if not path.is_file():
            raise CorruptEpisode(f"{path} is missing or not a file.")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > MOST_BYTES:
                raise CorruptEpisode(f"{path} has more than {MOST_BYTES >> 20} MB, too much for a description.")
            return file.read(size)
    except OSError as err:
        raise CorruptEpisode(f"Cannot read {path}: {err.strerror or err}.") from err


def parsed_json(data: bytes | str, path: Path | str) -> dict[str, Any]:
    """Return the JSON object in some text.

    Args:
        data: The text, bytes as UTF-8.
        path: The file, for the message.

    Raises:
        CorruptEpisode: It is not a JSON object, is nested too deeply, or has an invalid number or text.
    """
    try:
        text = data if isinstance(data, str) else data.decode()
        values = _DECODER.decode(text)
    except (ValueError, RecursionError) as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err
    if not isinstance(values, dict):
        raise CorruptEpisode(f"{path} is damaged: it is not a JSON object.")
    if text.count("{") + text.count("[") > MOST_DEPTH and depth_of(values) > MOST_DEPTH:
        raise CorruptEpisode(f"{path} is damaged: its values are nested more than {MOST_DEPTH} levels deep.")
    # Half surrogate pairs are written as escapes, so only text with such escapes is searched.
    if "\\ud" in text.lower() and not is_storable(json.dumps(values, ensure_ascii=False)):
        raise CorruptEpisode(f"{path} is damaged: a text in it has half of a surrogate pair.")
    return values


def depth_of(value: Any) -> int:
    """Return how deep values are nested: 0 for a number, 1 for a list of numbers; inexact beyond `MOST_DEPTH`."""
    depth = 0
    level = [value] if isinstance(value, dict | list | tuple) else []
    while level and depth <= MOST_DEPTH:
        depth += 1
        inner = (part for outer in level for part in (outer.values() if isinstance(outer, dict) else outer))
        level = [part for part in inner if isinstance(part, dict | list | tuple)]
    return depth


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is out of range")
    return value


def _whole_number(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)


_DECODER = json.JSONDecoder(parse_constant=_refused, parse_float=_number, parse_int=_whole_number)
