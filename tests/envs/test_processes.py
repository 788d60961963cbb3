"""Environments in processes of somebody else's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv

import rcs
from rcs.errors import InvalidAction


def make_one() -> rcs.Env:
    return rcs.make("PickCuboid", max_episode_steps=3)


@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")  # Gymnasium's words on the error that is wanted
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_gymnasiums_workers_give_the_bits_of_one_process_and_pass_errors_on(start: str) -> None:
    single = make_one()
    expected, _ = single.reset(seed=4)
    envs = AsyncVectorEnv([make_one] * 2, context=start)
    try:
        observations, _ = envs.reset(seed=3)
        np.testing.assert_array_equal(observations["joints"][1], expected["joints"])
        for _ in range(3):
            actions: Any = envs.action_space.sample()
            observations, rewards, _, truncated, _ = envs.step(actions)
            own, reward, _, is_over, _ = single.step({key: value[1] for key, value in actions.items()})
            np.testing.assert_array_equal(observations["joints"][1], own["joints"])
            assert (rewards[1], truncated[1]) == (reward, is_over)
        assert truncated.all()
        envs.reset()
        with pytest.raises(InvalidAction, match="joints"):
            envs.step({**actions, "joints": np.full((2, 7), np.nan)})
    finally:
        envs.close()
