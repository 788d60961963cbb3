"""Laws of the rewards: what shaping adds up to, that it changes no optimal policy, and what success is worth."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.reward import Rewards
from rcs.envs.task import Judgement, Task
from rcs.errors import InvalidSetup

DISCOUNT = 0.97
AUTORESETS = ["NextStep", "SameStep", "Disabled"]


class Wander(Task):
    """Has a progress that goes up and down, succeeds where the first joint is far to one side, ends far to the other."""

    def bind(self, world: Any, robots: Any) -> None:
        self._robot = robots[0]

    def reset(self, draws: Any, where: Any) -> None: ...

    def evaluate(self) -> Judgement:
        first = self._robot.joints[..., 0]
        progress = 0.5 + 0.5 * np.sin(40.0 * first)
        return Judgement(
            success=first > 0.11, terminated=np.abs(first) > 0.11, progress=progress, info={"progress": progress}
        )

    def describe(self) -> dict[str, Any]:
        return {"progress": self.evaluate().progress}


def shaping_of(episode: list[tuple[float, bool]]) -> float:
    """Return the discounted sum of what shaping paid in an episode of rewards and successes."""
    return sum(DISCOUNT**step * (reward - success) for step, (reward, success) in enumerate(episode))


def wander(rng: np.random.Generator, space: Any) -> dict[str, np.ndarray]:
    """Return actions that turn the first joint by up to 2 degrees, mostly in the direction of the copy's parity."""
    shape = space["joints"].shape
    joints = np.zeros(shape)
    side = np.where(np.arange(shape[0]) % 2, 1.0, -1.0) if len(shape) == 2 else 1.0
    joints[..., 0] = 0.035 * (side * 0.3 + rng.uniform(-1.0, 1.0, shape[:-1]))
    return {"joints": joints, "gripper": np.ones(space["gripper"].shape, np.float32)}


@pytest.mark.parametrize("autoreset", AUTORESETS)
def test_shaping_adds_up_to_the_discounted_potential_of_the_end_minus_that_of_the_start(autoreset: str) -> None:
    envs = rcs.make_vec(Wander, copies=6, discount=DISCOUNT, max_episode_steps=25, autoreset=autoreset, threads=1)
    _, info = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    starts = info["progress"].copy()
    episodes: list[list[tuple[float, bool]]] = [[] for _ in range(6)]
    ends = {"success": 0, "failure": 0, "truncated": 0}
    was_over = np.zeros(6, np.bool_)
    for _ in range(90):
        _, reward, terminated, truncated, info = envs.step(wander(rng, envs.action_space))
        is_over = terminated | truncated
        last = info["final_info"] if autoreset == "SameStep" and is_over.any() else info
        for copy in range(6):
            if was_over[copy] and autoreset == "NextStep":
                assert reward[copy] == 0.0, "the start of an episode is no step"
                starts[copy], episodes[copy] = info["progress"][copy], []
                continue
            episodes[copy].append((float(reward[copy]), bool(last["success"][copy])))
            if is_over[copy]:
                end = 0.0 if terminated[copy] else DISCOUNT ** len(episodes[copy]) * last["progress"][copy]
                assert shaping_of(episodes[copy]) == pytest.approx(end - starts[copy], abs=1e-9)
                kind = "truncated" if truncated[copy] else "success" if last["success"][copy] else "failure"
                ends[kind] += 1
        was_over = is_over
        if autoreset == "Disabled" and is_over.any():
            envs.reset(options={"reset_mask": is_over})
        if autoreset != "NextStep":
            starts = np.where(is_over, envs.scenario.task.describe()["progress"], starts)
            episodes = [[] if over else own for own, over in zip(episodes, is_over, strict=True)]
    assert min(ends.values()) > 0, ends
