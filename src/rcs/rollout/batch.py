"""Many episodes at a time: one agent acts in all copies of an environment, and each episode is as it is by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.rollout.collect import Attempt
from rcs.rollout.episode import OPEN, EpisodeResult


def run_batch(
    envs: VecEnv, agent: Agent, numbers: Iterable[int], seed_of: Callable[[int], int | None]
) -> Iterator[Attempt]:
    """Run episodes in all copies of an environment, and yield each as it ends.

    A copy whose episode is over starts the next one at once. An episode depends on its seed alone: its result is that
    of `run_episode`, if the agent does in a batch what it does alone.

    Args:
        envs: Copies, made with `autoreset="Disabled"`.
        agent: Takes observations of all copies, (copies, ...) per key, and returns actions of all; it remembers nothing
            from step to step, and gets the first starts only.
        numbers: The episodes; one is taken when a copy is free.
        seed_of: Returns the seed of a number.

    Raises:
        InvalidSetup: The copies start anew by themselves.
    """
    if envs.metadata["autoreset_mode"] is not AutoresetMode.DISABLED:
        raise InvalidSetup("Episodes of a batch are started by their seeds; use make_vec(..., autoreset='Disabled').")
    waiting, copies = iter(numbers), envs.num_envs
    number: list[int | None] = [next(waiting, None) for _ in range(copies)]
    seeds = [None if one is None else seed_of(one) for one in number]
    observation, info = envs.reset(seed=seeds)
    agent.reset(observation, info)
    steps, total = np.zeros(copies, np.int64), np.zeros(copies)
    was_touched = np.zeros(copies, np.bool_)
    while any(one is not None for one in number):
        action = agent.act(observation, info)
        observation, reward, terminated, truncated, info = envs.step(action)
        steps += 1
        total += reward
        was_touched |= np.asarray(info.get("is_touched", False)) & _is_open(action, copies)
        is_over = terminated | truncated
        if not is_over.any():
            continue
        next_seeds: list[int | None] = [None] * copies
        for copy in np.flatnonzero(is_over).tolist():
            ended = number[copy]
            if ended is not None:
                success, failure = _verdict(info, copy, bool(was_touched[copy]), agent)
                result = EpisodeResult(
                    seed=seeds[copy],
                    steps=int(steps[copy]),
                    success=success,
                    failure=failure,
                    reward=float(total[copy]),
                )
                yield Attempt(number=ended, result=result)
            number[copy] = next(waiting, None)
            if (begun := number[copy]) is not None:
                next_seeds[copy] = seeds[copy] = seed_of(begun)
        steps[is_over], total[is_over], was_touched[is_over] = 0, 0.0, False
        observation, info = envs.reset(seed=next_seeds, options={"reset_mask": is_over})


def _verdict(info: Mapping[str, Any], copy: int, was_touched: bool, agent: Agent) -> tuple[bool | None, str | None]:
    """Return success and failure of a copy's episode, as `run_episode` tells them."""
    end = str(info["end"][copy])
    if end in (FAULT, DIVERGED):
        return False, end
    verdicts = info.get("success")
    success = None if verdicts is None else bool(verdicts[copy])
    return success, (agent.failure or ("collision" if was_touched else "timeout")) if success is False else None


def _is_open(action: Mapping[str, Any], copies: int) -> NDArray[np.bool_]:
    """Return in which copies every gripper was commanded to be open."""
    parts = list(action.values()) if all(isinstance(value, Mapping) for value in action.values()) else [action]
    if not all("gripper" in part for part in parts):
        return np.zeros(copies, np.bool_)
    return np.all([np.reshape(part["gripper"], (copies, -1)).min(-1) >= OPEN for part in parts], axis=0)
