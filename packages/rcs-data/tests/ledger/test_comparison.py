"""Comparisons of agents: exact tests, intervals that cover, and evidence that holds however often one looks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data.errors import InvalidSetup
from rcs_data.ledger.comparison import FEWEST, Pairs, holm, mean_maximum_rank_violation, pearson

counts = st.integers(0, 60)
pairs = st.builds(Pairs, both=counts, only_a=counts, only_b=counts, neither=counts)
verdicts = st.dictionaries(st.integers(0, 30), st.sampled_from([True, False, None]))


def mirrored(one: Pairs) -> Pairs:
    """Return the same comparison with A and B exchanged."""
    return Pairs(both=one.both, only_a=one.only_b, only_b=one.only_a, neither=one.neither)


@given(verdicts, verdicts)
def test_every_seed_counts_once(a: dict[int, bool | None], b: dict[int, bool | None]) -> None:
    found = Pairs.of(a, b)
    assert found.n + found.left_out == len(a.keys() | b.keys())
    assert found.only_a == sum(a[seed] is True and b.get(seed) is False for seed in a)
    assert Pairs.of(b, a) == Pairs(**{**vars(mirrored(found)), "left_out": found.left_out})


@given(pairs)
def test_exchanging_the_agents_mirrors_everything(one: Pairs) -> None:
    other = mirrored(one)
    assert other.p == one.p
    assert other.evidence == pytest.approx(one.evidence)
    assert other.interval == pytest.approx((-one.interval[1], -one.interval[0]))


@given(pairs.filter(lambda one: one.n > 0))
def test_the_interval_has_the_difference_and_stays_in_range(one: Pairs) -> None:
    low, high = one.interval
    assert one.difference is not None
    assert -1 <= low <= one.difference <= high <= 1


def test_the_interval_is_that_of_the_source() -> None:
    # Newcombe (1998), table II: 36, 12, 2 and 0 of 50 pairs.
    assert Pairs(both=36, only_a=12, only_b=2).interval == pytest.approx((0.0569, 0.3404), abs=5e-4)


@given(st.integers(0, 40), st.integers(0, 40))
def test_the_p_value_is_the_share_of_coins_that_fall_as_unevenly(a: int, b: int) -> None:
    n = a + b
    away = sum(math.comb(n, k) for k in range(n + 1) if abs(2 * k - n) >= abs(a - b))
    assert Pairs(only_a=a, only_b=b).p == pytest.approx(away / 2**n)


def test_with_fewer_than_six_different_pairs_nothing_is_decided() -> None:
    assert Pairs(only_a=FEWEST - 1).p > 0.05
    assert Pairs(only_a=FEWEST).p < 0.05
    assert not any(Pairs(only_a=k, both=100).is_decided(0.9) for k in range(FEWEST))


@given(st.integers(0, 200), st.integers(0, 200))
def test_the_evidence_neither_grows_nor_shrinks_on_average_while_agents_are_equal(a: int, b: int) -> None:
    next_ones = Pairs(only_a=a + 1, only_b=b).evidence, Pairs(only_a=a, only_b=b + 1).evidence
    assert sum(next_ones) / 2 == pytest.approx(Pairs(only_a=a, only_b=b).evidence, rel=1e-9)


def test_looking_after_every_pair_decides_for_equal_agents_in_at_most_5_of_100_comparisons() -> None:
    coins = np.random.default_rng(0).random((400, 120)) < 0.5
    wins = np.cumsum(coins, axis=1)
    decided = [
        any(Pairs(only_a=int(a), only_b=k - int(a)).is_decided(0.05) for k, a in enumerate(row, 1)) for row in wins
    ]
    assert np.mean(decided) <= 0.05


def test_pairs_that_seem_needed_show_the_difference_about_as_often_as_said() -> None:
    seen = Pairs(both=150, only_a=14, only_b=6, neither=30)
    needed = seen.needed()
    assert needed is not None
    assert needed > seen.n
    random = np.random.default_rng(1)
    cells = random.multinomial(needed, [0.75, 0.07, 0.03, 0.15], 500)
    shown = [Pairs(both=c[0], only_a=c[1], only_b=c[2], neither=c[3]).p <= 0.05 for c in cells.tolist()]
    assert 0.7 < np.mean(shown) < 0.9


@given(st.integers(1, 8), st.sampled_from([0.05, 0.01, 0.001]))
def test_pairs_that_all_agree_show_it_once_there_are_as_many_as_needed(count: int, level: float) -> None:
    needed = Pairs(only_a=count).needed(level)
    assert needed is not None
    assert Pairs(only_a=needed).p <= level


def test_equal_agents_need_no_number_of_pairs() -> None:
    assert Pairs(both=5, only_a=3, only_b=3).needed() is None
    assert Pairs().difference is None


@given(st.lists(st.floats(0, 1), max_size=8))
def test_adjusted_p_values_keep_their_order_and_only_grow(p_values: list[float]) -> None:
    adjusted = holm(p_values)
    assert all(p <= q <= 1 for p, q in zip(p_values, adjusted, strict=True))
    by_p = sorted(zip(p_values, adjusted, strict=True))
    assert [q for _, q in by_p] == sorted(adjusted)


def test_the_smallest_p_value_is_multiplied_by_their_number() -> None:
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])


def test_a_simulation_in_the_order_of_reality_violates_no_rank() -> None:
    real = [0.2, 0.5, 0.9]
    assert mean_maximum_rank_violation(real, [0.1, 0.2, 0.3]) == 0
    assert mean_maximum_rank_violation(real, [0.3, 0.2, 0.9]) == pytest.approx((0.3 + 0.3 + 0) / 3)
    assert pearson(real, [0.4, 1.0, 1.8]) == pytest.approx(1.0)
    for same in (0.5, 0.1):  # three times 0.1, over three, is not 0.1
        assert pearson(real, [same] * 3) is None
        assert pearson([same] * 3, [same] * 3) is None


def test_rates_of_different_policies_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="2 real and 1 simulated rates"):
        pearson([0.1, 0.2], [0.1])
    with pytest.raises(InvalidSetup, match="at least two policies"):
        mean_maximum_rank_violation([0.1], [0.1])
