"""Helpers that the tests of drawing share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import pytest

from rcs import _core


@pytest.fixture
def make() -> Iterator[Callable[..., _core.Renderer]]:
    """Make renderers that are closed after the test."""
    made: list[_core.Renderer] = []

    def make_renderer(model: mujoco.MjModel, **options: Any) -> _core.Renderer:
        made.append(_core.Renderer(model, **options))
        return made[-1]

    yield make_renderer
    for renderer in made:
        renderer.close()
