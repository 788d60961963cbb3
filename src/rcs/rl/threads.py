"""The number of torch's threads with which training is fastest, by measurement."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.rl.algorithms import Ppo
from rcs.rl.flat import Flat
from rcs.rl.networks import make_policy
from rcs.rl.packages import package
from rcs.rl.sb3_learner import batch_size
from rcs.rl.training import Training

_SECONDS, _ROUNDS = 0.2, 3
"""How long each number is tried in each round [s], and how many rounds there are; the best one counts."""


def cpus() -> int:
    """Return how many CPUs this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fastest_threads(training: Training, flat: Flat) -> dict[int, float]:
    """Measure how many updates per second torch makes on the CPU, with the actions for their steps.

    Args:
        training: What is learned.
        flat: The maps of its policy.

    Returns:
        Updates per second by number of threads, the fastest first; of those within 3 %, the smallest number.
    """
    torch, algorithm = package("torch"), training.algorithm
    before = torch.get_num_threads()
    decisions, gradients = 1, 1
    if isinstance(algorithm, Ppo):
        decisions = algorithm.n_steps
        gradients = algorithm.n_epochs * (training.copies * algorithm.n_steps // batch_size(training))
    else:
        gradients = algorithm.gradient_steps
    policy = make_policy(algorithm, flat)
    few, many = (_zeros(flat, rows) for rows in (training.copies, batch_size(training)))

    def decide() -> None:
        with torch.no_grad():
            policy(few)

    def learn() -> None:
        policy.zero_grad()
        outputs = policy(many)
        parts = outputs if isinstance(outputs, tuple) else (outputs,)
        torch.cat([one.reshape(-1) for one in parts]).mean().backward()

    def speed(threads: int) -> float:
        torch.set_num_threads(threads)
        return 1.0 / (decisions / _rate(decide) + gradients / _rate(learn))

    try:
        return ranked({min(2**i, cpus()) for i in range(cpus().bit_length() + 1)}, speed)
    finally:
        torch.set_num_threads(before)


def ranked(numbers: set[int], speed: Callable[[int], float]) -> dict[int, float]:
    """Return numbers with the best of several speeds each, the fastest first; see `fastest_threads`."""
    figures = dict.fromkeys(sorted(numbers), 0.0)
    for _ in range(_ROUNDS):  # in turns: what disturbs one number for a moment does not decide
        for number in figures:
            figures[number] = max(figures[number], speed(number))
    best = next(number for number, figure in figures.items() if figure >= 0.97 * max(figures.values()))
    return {best: figures.pop(best), **figures}


def _rate(call: Callable[[], Any]) -> float:
    """Return how many calls there are in a second."""
    call()  # the first one has work of its own
    count, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < _SECONDS:
        call()
        count += 1
    return count / passed


def _zeros(flat: Flat, rows: int) -> Any:
    torch, space = package("torch"), flat.observation_space
    parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    made = {name: torch.from_numpy(np.zeros((rows, *(one.shape or ())), one.dtype)) for name, one in parts.items()}
    return made if isinstance(space, spaces.Dict) else made[""]
