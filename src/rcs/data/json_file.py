"""JSON from a disk, which anybody may have written: of bounded size and depth, with finite numbers and whole texts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NoReturn

from rcs.data.text import is_storable
from rcs.errors import CorruptEpisode

MOST_BYTES = 1 << 26
"""A file is not read beyond this. The `dataset.json` of 50 000 episodes grows by some 0.8 MB with each edit."""
MOST_DEPTH = 64
"""Values are not nested deeper: what works through them calls itself, and Python ends that at 1000 levels."""
# A whole number beyond this has no place in a file of numbers, and takes time that grows with its square.
_MOST_DIGITS = 40


def read_json(path: Path) -> dict[str, Any]:
    """Read a file with one JSON object.

    Raises:
        CorruptEpisode: It is missing, no JSON object, or larger or deeper than any that a dataset has.
    """
    return parsed_json(read_bytes(path), path)


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """Read a file with a JSON object per line.

    Raises:
        CorruptEpisode: It is missing, or a line is no JSON object.
    """
    # Only at "\n": `splitlines` also takes a line separator within a text for the end of a line.
    return [parsed_json(line, path) for line in read_bytes(path).split(b"\n") if line.strip()]


def read_bytes(path: Path) -> bytes:
    """Read a file of a size that a description may have.

    Raises:
        CorruptEpisode: It is missing, no file, or too large.
    """
    try:
        if not path.is_file():
            raise CorruptEpisode(f"{path} is missing or no file.")
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as err:
        raise CorruptEpisode(f"{path} does not read: {err.strerror or err}.") from err
    if len(data) > MOST_BYTES:
        raise CorruptEpisode(f"{path} has more than {MOST_BYTES >> 20} MB, which no description has; it is not read.")
    return data


def parsed_json(data: bytes | str, path: Path | str) -> dict[str, Any]:
    """Return the JSON object in some text.

    Args:
        data: The text, bytes as UTF-8.
        path: Where it came from, for the message.

    Raises:
        CorruptEpisode: It is no JSON object, is nested too deeply, or has a number or text that JSON cannot have.
    """
    try:
        text = data if isinstance(data, str) else data.decode()
        values = json.loads(text, parse_constant=_refused, parse_float=_number, parse_int=_whole_number)
    except (ValueError, RecursionError) as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err
    if not isinstance(values, dict):
        raise CorruptEpisode(f"{path} is damaged: it is no JSON object.")
    if depth_of(values) > MOST_DEPTH:
        raise CorruptEpisode(f"{path} is damaged: its values are nested more than {MOST_DEPTH} levels deep.")
    # Halves of surrogate pairs come in as escapes, so text without escapes of them needs no look.
    if "\\ud" in text.lower() and not is_storable(json.dumps(values, ensure_ascii=False)):
        raise CorruptEpisode(f"{path} is damaged: a text in it has half of a surrogate pair.")
    return values


def depth_of(value: Any) -> int:
    """Return how deep values are nested: 0 for a number, 1 for a list of numbers; beyond `MOST_DEPTH` not exactly."""
    depth = 0
    level = [value] if isinstance(value, dict | list | tuple) else []
    while level and depth <= MOST_DEPTH:
        depth += 1
        inner = (part for outer in level for part in (outer.values() if isinstance(outer, dict) else outer))
        level = [part for part in inner if isinstance(part, dict | list | tuple)]
    return depth


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON")


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is beyond the numbers that there are")
    return value


def _whole_number(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)
