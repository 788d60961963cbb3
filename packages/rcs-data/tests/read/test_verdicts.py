"""Three verdicts: only episodes that were judged make a rate."""

from __future__ import annotations

from hypothesis import given, strategies
from rcs_data.read.verdicts import Verdicts, wilson_interval

verdicts = strategies.lists(strategies.sampled_from([True, False, None]))


@given(verdicts, strategies.integers(0, 20))
def test_episodes_that_nobody_judged_change_no_rate(given_verdicts: list[bool | None], more: int) -> None:
    one, other = Verdicts.of(given_verdicts), Verdicts.of([*given_verdicts, *[None] * more])
    assert (one.rate, one.interval, str(one)) == (other.rate, other.interval, str(other))
    assert other.not_judged == one.not_judged + more


@given(verdicts)
def test_every_episode_counts_once(given_verdicts: list[bool | None]) -> None:
    counted = Verdicts.of(given_verdicts)
    assert counted.succeeded + counted.failed + counted.not_judged == len(given_verdicts)
    assert counted.interval == wilson_interval(counted.succeeded, counted.judged)


def test_without_a_verdict_there_is_no_rate() -> None:
    assert str(Verdicts.of([None, None])) == "not judged"
    assert str(Verdicts.of([True] * 67 + [None] * 23)).startswith("67 of 67 judged = 100.0 %")
