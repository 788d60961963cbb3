"""What all tests share: tests marked `gl` are skipped, with the reason, where nothing can draw."""

from __future__ import annotations

import functools

import pytest


@functools.cache
def why_nothing_draws() -> str:
    """Return why no OpenGL backend works; empty when one does."""
    from rcs._core import probe_gl

    probes = probe_gl()
    return "" if any(probe.ok for probe in probes) else "; ".join(f"{probe.name}: {probe.detail}" for probe in probes)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test that draws where nothing can."""
    if item.get_closest_marker("gl") and (reason := why_nothing_draws()):
        pytest.skip(reason)
