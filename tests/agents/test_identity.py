"""Everything that makes an agent has an identity, which tells it from others."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest

from rcs.agents import PickExpert
from rcs.agents.identity import identity_of
from rcs.errors import InvalidSetup


def make(env: Any, speed: float = 0.2) -> PickExpert:
    return PickExpert(env)


FAST = partial(make, speed=0.4)


def test_a_function_is_known_by_where_it_is() -> None:
    name = f"{make.__module__}:make"
    for agent in (make, name):
        found = identity_of(agent, "PickCuboid")
        assert (found.name, found.modules) == (name, (make.__module__,))


def test_a_name_may_stand_for_a_partial() -> None:
    name = f"{make.__module__}:FAST"
    found = identity_of(name, "PickCuboid")
    assert (found.name, found.modules) == (name, (make.__module__,))


def made(speed: float) -> Any:
    def inner(env: Any) -> PickExpert:
        return make(env, speed)

    return inner


@pytest.mark.parametrize("agent", [lambda env: make(env), made(0.3), FAST], ids=["lambda", "closure", "partial"])
def test_what_has_no_name_is_refused(agent: Any) -> None:
    """Two of them could not be told apart."""
    with pytest.raises(InvalidSetup, match="valid is a name, 'module:NAME', or a class"):
        identity_of(agent, "PickCuboid")
