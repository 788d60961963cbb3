"""The number of threads is measured in turns, so that what disturbs it for a moment does not decide."""

from __future__ import annotations

from rcs.rl.threads import ranked


def fastest(rounds: list[dict[int, float]]) -> int:
    """Return the number of threads that is chosen among 1, 2 and 4, by figures per round."""
    waiting = {number: [each[number] for each in rounds] for number in (1, 2, 4)}
    figures = ranked({1, 2, 4}, lambda number: waiting[number].pop(0))
    assert sorted(figures) == [1, 2, 4]
    return next(iter(figures))


def test_the_best_round_of_each_number_counts() -> None:
    calm, disturbed = {1: 700.0, 2: 1300.0, 4: 2500.0}, {1: 700.0, 2: 400.0, 4: 300.0}
    assert fastest([disturbed, calm, disturbed]) == 4


def test_of_equals_the_fewest_are_taken() -> None:
    assert fastest([{1: 700.0, 2: 717.0, 4: 600.0}] * 3) == 1
