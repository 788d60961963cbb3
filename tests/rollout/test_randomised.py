"""Randomised episodes are recorded with what was drawn, and replay bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import agent_for
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.replay import replay

SETUP = rcs.Setup(randomisation=rcs.Randomisation(distractors=2))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("randomised") / "dataset"
    for _ in collect(Collection(setup=SETUP, out=out, episodes=3, seed=1), Progress()):
        pass
    return out


def test_every_randomised_episode_replays_bit_for_bit(dataset: Path) -> None:
    assert setup_of(Dataset.open(dataset)) == SETUP
    results = list(replay(dataset))
    assert len(results) == 3
    assert all(result.is_equal for result in results)


def test_what_was_drawn_is_kept_with_the_episode(dataset: Path) -> None:
    env = rcs.make(SETUP)
    for episode in Dataset.open(dataset).episodes:
        _, info = env.reset(seed=episode.seed)
        kept = episode.outcome["randomisation"]
        assert kept.keys() == info["randomisation"].keys()
        for field, values in info["randomisation"].items():
            np.testing.assert_array_equal(kept[field], values)


def test_the_expert_succeeds_on_20_of_20_randomised_episodes() -> None:
    env = rcs.make(SETUP)
    expert = agent_for(env)
    assert sum(run_episode(env, expert, seed=seed).success for seed in range(20)) == 20
