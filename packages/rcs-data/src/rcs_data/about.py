"""`episode.json`: read here alone, and checked field by field, so that all other code may trust it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rcs_data.durable import unsealed
from rcs_data.errors import CorruptEpisode
from rcs_data.info import refuse_newer_schema
from rcs_data.json_file import read_bytes
from rcs_data.layout import EPISODE_FILE, FRAMES_FILE, STEPS_FILE, is_name

MOST_ROWS = 1 << 32
"""Rows of an episode; 30 Hz for four years."""
MOST_SEED = 1 << 128
"""Seeds are below this: `numpy.random.SeedSequence` makes 128 bits of them."""

# Only an episode that was derived from another one has a source.
_OPTIONAL = ("source",)
_HASH = re.compile(r"[0-9a-f]{64}")


def read_about(folder: Path) -> dict[str, Any]:
    """Read the `episode.json` in an episode's folder.

    Raises:
        CorruptEpisode: It is missing, was changed, or has impossible values.
        DatasetError: Its layout is newer than this code.
    """
    path = folder / EPISODE_FILE
    return checked_about(unsealed(read_bytes(path), path), path)


def checked_about(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the fields of an `episode.json` after checking them.

    Args:
        values: Its fields.
        path: Where it is, for the message.

    Raises:
        CorruptEpisode: A field is missing or not valid; the message names it and what is valid.
        DatasetError: Its layout is newer than this code.
    """
    refuse_newer_schema(values.get("schema_version"), f"episode, {path.parent},")
    for name, (is_right, valid) in _FIELDS.items():
        is_there = name in values or name in _OPTIONAL
        if not is_there or not is_right(values.get(name)):
            given = repr(values[name])[:80] if name in values else "missing"
            raise CorruptEpisode(f"{path} is damaged: {name} is {given}; valid is {valid}.")
    return values


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and _HASH.fullmatch(value) is not None


def _is_length(value: Any) -> bool:
    return _is_whole(value) and 1 <= value <= MOST_ROWS


def _is_seed(value: Any) -> bool:
    return value is None or (_is_whole(value) and abs(value) < MOST_SEED)


def _is_verdict(value: Any) -> bool:
    return value is None or isinstance(value, bool)


def _is_time(value: Any) -> bool:
    return value is None or isinstance(value, str)


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _of(value: Any, is_right: Callable[[Any], bool]) -> bool:
    return isinstance(value, dict) and all(map(is_right, value.values()))


def _are_hashes(value: Any) -> bool:
    # The keys are file names: only those of an episode's own files.
    return _of(value, _is_hash) and STEPS_FILE in value and not set(value) - {STEPS_FILE, FRAMES_FILE}


PERIOD = (
    *("expected", "mean", "p50", "p99", "max", "jitter_p50", "jitter_p99", "jitter_max"),
    *("gaps", "missed_steps", "backwards"),
)
"""Fields of the timing report's `period`, as `TimingMeter` measures them."""


def _is_timing(value: Any) -> bool:
    if not isinstance(value, dict):
        return False
    period, cameras, writer = (value.get(name) for name in ("period", "cameras", "writer"))
    is_count = lambda count: count is None or (_is_whole(count) and count >= 0)  # noqa: E731  a word for one line
    return (
        (period is None or (_of(period, _is_number) and set(PERIOD) <= set(period)))
        and (cameras is None or _of(cameras, lambda camera: _of(camera, is_count)))
        and (writer is None or _of(writer, _is_number))
    )


def _is_source(value: Any) -> bool:
    """Return whether this is a valid source of an episode; its names may become folders' names."""
    if value is None:
        return True
    if not isinstance(value, dict):
        return False
    given: Mapping[str, Any] = value
    names_are_right = all(isinstance(given.get(name), str) and is_name(given[name]) for name in ("dataset", "episode"))
    return names_are_right and _is_source(given.get("source"))


_FIELDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "id": (_is_text, "text"),
    "seed": (_is_seed, "a whole number of up to 128 bits, or null"),
    "success": (_is_verdict, "true, false, or null for not judged"),
    "length": (_is_length, f"a whole number from 1 to {MOST_ROWS}"),
    "outcome": (_is_object, "an object"),
    "instruction": (_is_text, "text"),
    "started": (_is_time, "text or null"),
    "ended": (_is_time, "text or null"),
    "versions": (lambda value: _of(value, _is_text), "an object of texts"),
    "content_hash": (_is_hash, "a SHA-256 in hexadecimal"),
    "sha256": (_are_hashes, f"the SHA-256 of {STEPS_FILE}, and of {FRAMES_FILE} if it is there"),
    "timing": (_is_timing, "an object with period, cameras and writer, each an object of numbers or null"),
    "source": (_is_source, "null, or an object with names as dataset and episode, and the source of that"),
}
