"""An environment for policies."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rcs
from rcs.envs import Env


@pytest.fixture
def env() -> Iterator[Env]:
    with rcs.make("Free", robot="fr3", relative=False) as made:
        yield made
