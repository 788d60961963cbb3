"""Many episodes at a time: one agent acts in all copies of an environment, and each episode is as it is by itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from gymnasium.vector import AutoresetMode

from rcs.agents import Agent
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult, is_open, stages_of, verdict


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
    was_touched, stages = np.zeros(copies, np.bool_), stages_of(info)
    begun_at = np.full(copies, time.perf_counter())
    while any(one is not None for one in number):
        action = agent.act(observation, info)
        observation, reward, terminated, truncated, info = envs.step(action)
        steps += 1
        total += reward
        was_touched |= np.asarray(info.get("is_touched", False)) & is_open(action, copies)
        if (now := stages_of(info)) is not None:
            stages = now if stages is None else np.maximum(stages, now)
        is_over = terminated | truncated
        if not is_over.any():
            continue
        next_seeds: list[int | None] = [None] * copies
        for copy in np.flatnonzero(is_over).tolist():
            ended = number[copy]
            if ended is not None:
                judged = None if "success" not in info else info["success"][copy]
                success, failure = verdict(str(info["end"][copy]), judged, bool(was_touched[copy]), agent)
                result = EpisodeResult(
                    seed=seeds[copy],
                    steps=int(steps[copy]),
                    success=success,
                    failure=failure,
                    reward=float(total[copy]),
                    stages=None if stages is None else int(stages[copy]),
                )
                seconds = time.perf_counter() - float(begun_at[copy])
                yield Attempt(number=ended, result=result, weights=agent.weights, seconds=seconds)
            number[copy] = next(waiting, None)
            if (begun := number[copy]) is not None:
                next_seeds[copy] = seeds[copy] = seed_of(begun)
                begun_at[copy] = time.perf_counter()
        steps[is_over], total[is_over], was_touched[is_over] = 0, 0.0, False
        if stages is not None:
            stages[is_over] = 0
        observation, info = envs.reset(seed=next_seeds, options={"reset_mask": is_over})
