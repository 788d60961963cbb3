"""Measure the speed of PPO on state, and the environment's share of the time.

The recipe of `rcs train PickCuboid`, with Stable-Baselines3's PPO through `Sb3VecEnv`, as it is trained: actions, whole
steps of all copies, rewards, restarts, then the update. The reference, in the same run, is the learner without an
environment: the same decisions and updates on the steps of the last rollout. Rounds alternate; medians.

Prints one JSON object: `fps` (environment steps per second of training), `env_share` (time inside of the environment
over the whole), `fps_without_env`, `env_steps_per_s` (the environment by itself), threads.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import torch
import tyro

import rcs
from rcs.rl import Sb3VecEnv, recipe_for
from rcs.rl.learner import Sb3Learner
from rcs.rl.train import cpus


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: str = "fr3"
    """The robot."""
    task: str = "PickCuboid"
    """The task."""
    frequency: float | None = None
    """Decisions per second [Hz]; None for the recipe's. Lower rates mean more physics per step."""
    threads: int = 0
    """Threads of the physics; 0 for one per CPU."""
    torch_threads: int = 1
    """Threads of torch."""
    rounds: int = 7
    """Number of measured updates."""


class TimedEnvs(Sb3VecEnv):
    """Copies that note how long their steps take, and can repeat what they returned last."""

    seconds = 0.0
    is_replayed = False
    _last: Any = None

    def step_wait(self) -> Any:
        """Make a step, or return the last one again."""
        if self.is_replayed:
            return self._last
        start = time.perf_counter()
        self._last = super().step_wait()
        self.seconds += time.perf_counter() - start
        return self._last


def main(options: Options) -> None:
    """Measure and print."""
    recipe = recipe_for(options.task)
    recipe = replace(recipe, setup=replace(recipe.setup, robot=options.robot))
    if options.frequency is not None:
        recipe = replace(recipe, setup=replace(recipe.setup, frequency=options.frequency))
    threads = options.threads or cpus()
    envs = rcs.make_vec(recipe.setup, copies=recipe.copies, threads=threads, autoreset="SameStep")
    timed = TimedEnvs(envs)
    torch.set_num_threads(options.torch_threads)
    learner = Sb3Learner(recipe, timed)
    learner.advance()  # the first one has work of its own
    whole, inside, without = [], [], []
    for _ in range(options.rounds):
        timed.seconds, begin = 0.0, time.perf_counter()
        before = learner.steps
        learner.advance()
        made = learner.steps - before
        whole.append(time.perf_counter() - begin)
        inside.append(timed.seconds)
        timed.is_replayed, begin = True, time.perf_counter()
        learner.advance()
        without.append(time.perf_counter() - begin)
        timed.is_replayed = False
    timed.close()
    print(
        json.dumps(
            {
                "benchmark": "ppo",
                "fps": round(made / median(whole)),
                "env_share": round(median(part / time for part, time in zip(inside, whole, strict=True)), 4),
                "fps_without_env": round(made / median(without)),
                "env_steps_per_s": round(made / median(inside)),
                "copies": recipe.copies,
                "control_hz": recipe.setup.frequency,
                "physics_threads": threads,
                "torch_threads": options.torch_threads,
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
