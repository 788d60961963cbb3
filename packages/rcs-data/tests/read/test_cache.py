"""A cache holds what fits, and forgets first what was not used for longest."""

from __future__ import annotations

import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.read.cache import ByteCache


def test_what_is_held_is_not_made_again() -> None:
    cache: ByteCache[str] = ByteCache(10)
    made: list[str] = []

    def make(name: str, size: int) -> str:
        return cache.get(name, lambda: (made.append(name) or name.upper(), size))

    assert [make("a", 4), make("b", 4), make("a", 4)] == ["A", "B", "A"]
    assert made == ["a", "b"]
    make("c", 4)  # of a and b, b was used before a
    assert (len(cache), cache.nbytes) == (2, 8)
    make("a", 4)
    make("b", 4)
    assert made == ["a", "b", "c", "b"]


def test_the_newest_stays_even_if_it_is_too_large() -> None:
    cache: ByteCache[int] = ByteCache(10)
    cache.get("small", lambda: (1, 5))
    assert cache.get("large", lambda: (2, 100)) == 2
    assert (len(cache), cache.nbytes) == (1, 100)
    assert cache.get("large", lambda: (3, 100)) == 2


def test_a_negative_capacity_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="-1 bytes"):
        ByteCache(-1)
