from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.envs.episode_random import EpisodeRandom

SEEDS = st.integers(0, 2**63 - 1)


@settings(max_examples=50, deadline=None)
@given(seeds=st.lists(SEEDS, min_size=1, max_size=5), episode=st.integers(0, 1000))
def test_a_copy_draws_what_a_single_environment_with_its_seed_draws(seeds: list[int], episode: int) -> None:
    batch = EpisodeRandom(seeds, [episode] * len(seeds))
    first, second = batch.uniform([-1.0, 0.0], [1.0, 5.0]), batch.uniform(0.0, 1.0)
    assert first.shape == (len(seeds), 2)
    for copy, seed in enumerate(seeds):
        single = EpisodeRandom(seed, episode)
        np.testing.assert_array_equal(single.uniform([-1.0, 0.0], [1.0, 5.0]), first[copy])
        np.testing.assert_array_equal(single.uniform(0.0, 1.0), second[copy])


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS, low=st.floats(-1e6, 1e6), width=st.floats(0, 1e6))
def test_draws_lie_inside_their_bounds(seed: int, low: float, width: float) -> None:
    draw = EpisodeRandom(seed, 0).uniform(low, low + width)
    assert low <= draw <= low + width


def test_draws_are_those_of_splitmix64_and_never_change() -> None:
    # Steele, Lea, Flood 2014: the first outputs of a generator that starts at 0.
    from rcs.sim.splitmix import GAMMA, mix

    with np.errstate(over="ignore"):
        states = np.arange(1, 4, dtype=np.uint64) * GAMMA
    expected = np.array([0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F], np.uint64)
    np.testing.assert_array_equal(mix(states), expected)
    assert int(EpisodeRandom(1, 2).bits()) == 0x3E12204644234BB0
    assert float(EpisodeRandom(1, 2).branch("light").uniform(0.0, 1.0)) == 0.8763211448408749


def test_neighbouring_seeds_and_episodes_draw_evenly_and_independently() -> None:
    seeds, episodes = np.meshgrid(np.arange(100), np.arange(100), indexing="ij")
    draws = EpisodeRandom(seeds, episodes).uniform(np.zeros(2), np.ones(2))
    assert draws.shape == (100, 100, 2)
    flat = draws.reshape(-1, 2)
    counts, *_ = np.histogram2d(flat[:, 0], flat[:, 1], bins=10, range=[[0, 1], [0, 1]])
    # Chi-squared with 99 degrees of freedom: above 148.2 once in a thousand.
    assert ((counts - 100) ** 2 / 100).sum() < 148.2
    for a, b in ((draws[:-1], draws[1:]), (draws[:, :-1], draws[:, 1:])):
        correlation = np.corrcoef(a[..., 0].ravel(), b[..., 0].ravel())[0, 1]
        assert abs(correlation) < 0.04
    assert len(np.unique(flat[:, 0])) == len(flat)


@settings(max_examples=50, deadline=None)
@given(seeds=st.lists(SEEDS, min_size=1, max_size=5), episode=st.integers(0, 1000))
def test_a_branch_draws_apart_from_its_parent_and_like_that_of_a_single_environment(
    seeds: list[int], episode: int
) -> None:
    batch, undisturbed = EpisodeRandom(seeds, [episode] * len(seeds)), EpisodeRandom(seeds, [episode] * len(seeds))
    branch = batch.branch("light").uniform(0.0, 1.0)
    first = batch.uniform(0.0, 1.0)
    np.testing.assert_array_equal(first, undisturbed.uniform(0.0, 1.0))
    np.testing.assert_array_equal(batch.branch("light").uniform(0.0, 1.0), branch)
    others = [first, batch.branch("mass").uniform(0.0, 1.0), batch.branch("a").branch("light").uniform(0.0, 1.0)]
    for other in others:
        assert (other != branch).all()
    for copy, seed in enumerate(seeds):
        assert EpisodeRandom(seed, episode).branch("light").uniform(0.0, 1.0) == branch[copy]
