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


@pytest.mark.parametrize(("factory", "name"), [(make, f"{make.__module__}:make"), (PickExpert, "PickExpert")])
def test_a_partial_is_what_it_calls_with_a_hash_of_its_arguments(factory: Any, name: str) -> None:
    slow, again, fast = (identity_of(partial(factory, speed=speed), "PickCuboid") for speed in (0.1, 0.1, 0.4))
    assert slow == again != fast
    assert slow.name.startswith(f"{name}(")
    assert slow.modules == (factory.__module__,)


def test_a_name_may_stand_for_a_partial() -> None:
    name = f"{make.__module__}:FAST"
    assert identity_of(name, "PickCuboid").name.startswith(f"{name}(")


def test_a_function_without_a_name_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="lambda"):
        identity_of(lambda env: make(env), "PickCuboid")
