"""Checks that the timing report of an episode agrees with its rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rcs_data.check.episode_rows import EpisodePlace
from rcs_data.check.report import Finding, listed
from rcs_data.layout import EPISODE_FILE


def check_timing(place: EpisodePlace, about: dict[str, Any], found: dict[str, Any]) -> Iterator[Finding]:
    """Yield a warning if the stored report disagrees with the rows.

    Entries that only one of them has are ignored, since versions report different things.
    """
    wrong = list(_differences("", about.get("timing"), found))
    if wrong:
        message = f"the timing report disagrees with the rows in {listed(wrong)}; --repair recomputes it"
        yield place.finding("warning", "timing", message, file=EPISODE_FILE)


def _differences(name: str, stored: Any, found: Any) -> Iterator[str]:
    if isinstance(stored, dict) and isinstance(found, dict):
        for key in sorted(stored.keys() & found.keys()):
            yield from _differences(f"{name}.{key}" if name else str(key), stored[key], found[key])
    elif not _is_equal(stored, found):
        yield name or "all of it"


def _is_equal(stored: Any, found: Any) -> bool:
    if isinstance(stored, float | int) and isinstance(found, float | int):
        return math.isclose(stored, found, rel_tol=1e-6, abs_tol=1e-9)
    return stored == found
