"""How many threads are fastest, measured: those of the copies' physics, and those of torch."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.rl.algorithms import Ppo
from rcs.rl.flat import Flat
from rcs.rl.networks import batch_size, make_policy
from rcs.rl.packages import package
from rcs.rl.training import Training
from rcs.setups.make import make_vec

_SECONDS, _ROUNDS = 0.2, 3
"""How long each number is tried in each round [s], and how many rounds there are; the best one counts."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """How fast a part of training is with some numbers of threads."""

    what: str
    unit: str
    figures: dict[int, float]
    """Figure by number of threads."""
    chosen: int
    """The number that is fastest. Of those within 3 %, it is the largest for physics, whose threads sleep when there is
    no work and may have been measured while something else ran, and the smallest for torch, whose threads do not."""

    def __str__(self) -> str:
        """Return it in words: "physics: 1 thread 870 steps/s, 2 threads 1560 steps/s; chosen: 2"."""
        tried = ", ".join(
            f"{number} thread{'s' * (number > 1)} {figure:.3g} {self.unit}" if figure < 100 else
            f"{number} thread{'s' * (number > 1)} {figure:.0f} {self.unit}"
            for number, figure in self.figures.items()
        )  # fmt: skip
        return f"{self.what}: {tried}; chosen: {self.chosen}"


def cpus() -> int:
    """Return how many CPUs this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def measure_physics(training: Training) -> Measured:
    """Measure how many steps per second the copies make, with random actions."""

    def speed(threads: int) -> float:
        envs = make_vec(training.setup, copies=training.copies, threads=threads, autoreset="SameStep")
        try:
            flat, rng = Flat(envs), np.random.default_rng(0)
            envs.reset(seed=training.first_seed)
            size = (training.copies, flat.layout.action_size)

            def step() -> None:
                flat.observation(envs.step(flat.action(rng.uniform(-1.0, 1.0, size)))[0])

            return training.copies * _rate(step)
        finally:
            envs.close()

    return _chosen("physics", "steps/s", speed, max)


def measure_torch(training: Training, flat: Flat) -> Measured:
    """Measure how many updates per second torch makes on the CPU, with actions for their steps."""
    torch, algorithm = package("torch"), training.algorithm
    before = torch.get_num_threads()
    if isinstance(algorithm, Ppo):
        decisions = algorithm.n_steps
        gradients = algorithm.n_epochs * (training.copies * algorithm.n_steps // batch_size(training))
    else:
        decisions, gradients = 1, algorithm.gradient_steps
    policy = make_policy(algorithm, flat)
    few, many = (_zeros(flat, rows) for rows in (training.copies, batch_size(training)))

    def decide() -> None:
        with torch.no_grad():
            policy(few)

    def learn() -> None:
        policy.zero_grad()
        outputs = policy(many)
        torch.cat(
            [one.reshape(-1) for one in (outputs if isinstance(outputs, tuple) else (outputs,))]
        ).mean().backward()

    def speed(threads: int) -> float:
        torch.set_num_threads(threads)
        return 1.0 / (decisions / _rate(decide) + gradients / _rate(learn))

    try:
        return _chosen("torch", "updates/s", speed, min)
    finally:
        torch.set_num_threads(before)


def _chosen(what: str, unit: str, speed: Callable[[int], float], prefer: Callable[[Iterable[int]], int]) -> Measured:
    most = cpus()
    figures = dict.fromkeys(sorted({min(2**i, most) for i in range(most.bit_length() + 1)}), 0.0)
    for _ in range(_ROUNDS):  # in turns: what disturbs one number for a moment does not decide
        for number, figure in figures.items():
            figures[number] = max(figure, speed(number))
    best = max(figures.values())
    chosen = prefer(number for number, figure in figures.items() if figure >= 0.97 * best)
    return Measured(what=what, unit=unit, figures=figures, chosen=chosen)


def _rate(call: Callable[[], Any]) -> float:
    """Return how many calls there are in a second."""
    call()  # the first one has work of its own
    count, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < _SECONDS:
        call()
        count += 1
    return count / passed


def _zeros(flat: Flat, rows: int) -> Any:
    torch = package("torch")
    space = flat.observation_space
    parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    made = {name: torch.from_numpy(np.zeros((rows, *(one.shape or ())), one.dtype)) for name, one in parts.items()}
    return made if isinstance(space, spaces.Dict) else made[""]
