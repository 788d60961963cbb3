"""The number of threads is measured in turns, so that what disturbs it for a moment does not decide."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rcs.rl import threads


@pytest.fixture
def choose(monkeypatch: pytest.MonkeyPatch) -> Callable[..., threads.Measured]:
    """Return a function that chooses among 1, 2 and 4 threads by figures per round."""
    monkeypatch.setattr(threads, "cpus", lambda: 4)

    def chosen(rounds: list[dict[int, float]], prefer: Callable[..., int]) -> threads.Measured:
        waiting = {number: [each[number] for each in rounds] for number in (1, 2, 4)}
        return threads._chosen("physics", "steps/s", lambda number: waiting[number].pop(0), prefer)

    return chosen


def test_the_best_round_of_each_number_counts(choose: Callable[..., threads.Measured]) -> None:
    calm, disturbed = {1: 700.0, 2: 1300.0, 4: 2500.0}, {1: 700.0, 2: 400.0, 4: 300.0}
    assert choose([disturbed, calm, disturbed], max).chosen == 4


def test_of_equals_physics_takes_the_most_and_torch_the_fewest(choose: Callable[..., threads.Measured]) -> None:
    equal = [{1: 700.0, 2: 717.0, 4: 600.0}] * 3
    assert choose(equal, max).chosen == 2
    assert choose(equal, min).chosen == 1
    assert str(choose(equal, min)).endswith(
        "1 thread 700 steps/s, 2 threads 717 steps/s, 4 threads 600 steps/s; chosen: 1"
    )
