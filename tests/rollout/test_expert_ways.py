"""The scripted expert's ways, beside those of another agent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from rcs_data import Dataset
from rcs_data.diversity import diversity_of_ways, ways_of

from rcs.agents import Agent
from rcs.envs.setup import Setup
from rcs.rollout.collect import Collection, Progress, collect
from rcs.rollout.expert_ways import expert_diversity


class Other(Agent):
    """Any agent."""


def test_the_expert_is_compared_in_the_same_episodes_and_without_cameras(tmp_path: Path) -> None:
    mine = Collection(setup=Setup(cameras=("wrist",)), out=tmp_path, episodes=2, seed=3)
    assert expert_diversity(mine) is None, "these are the expert's own episodes"
    bare = replace(mine, setup=Setup())
    assert len(list(collect(bare, Progress()))) == 2
    dataset = Dataset.open(tmp_path)
    recorded = diversity_of_ways(ways_of(dataset.info, list(dataset)))
    found = expert_diversity(replace(mine, agent=Other))
    assert found is not None
    np.testing.assert_allclose(found, recorded)


def test_nothing_is_compared_where_a_task_has_no_expert(tmp_path: Path) -> None:
    free = Collection(setup=Setup(task="Free"), out=tmp_path, episodes=2, agent=Other)
    assert expert_diversity(free) is None
