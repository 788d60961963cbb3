"""Helpers that tests of clusters share: waiting for something, and looking at the processes that are left."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# A loaded machine takes its time to start processes.
_PATIENCE = 240.0


def _wait_for(is_true: Callable[[], Any], what: str, seconds: float = _PATIENCE) -> None:
    end = time.monotonic() + seconds
    while not is_true():
        assert time.monotonic() < end, f"not so after {seconds} s: {what}"
        time.sleep(0.05)


def _processes_with(mark: str) -> list[str]:
    """Return the command lines of all processes that have a text in their environment."""
    found: list[str] = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes():
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:  # it has ended
            continue
    # Pools of processes on this machine share a tracker, which ends with the tests.
    return [line for line in found if line and "multiprocessing.resource_tracker" not in line]


@pytest.fixture(scope="session")
def wait_for() -> Callable[..., None]:
    """Wait until something is so, or fail with words for it."""
    return _wait_for


@pytest.fixture(scope="session")
def processes_with() -> Callable[[str], list[str]]:
    """Return the command lines of the processes that have a text in their environment."""
    return _processes_with
