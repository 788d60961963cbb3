"""What a whole step of `make_vec` costs on top of MuJoCo's own batch stepping of the same model.

Ours: actions checked and mapped through the layers, physics, observations, reward, autoreset. The reference:
`mujoco.batch.Batch.step` alone, from the same states, with the same threads and the same number of physics steps per
control step. Rounds alternate; the ratio is the median over rounds.

Prints one JSON object: `efficiency` (ours over the reference), `env_steps_per_s`, `batch_steps_per_s`.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from statistics import median

import numpy as np
import tyro
from mujoco.batch import Batch

import rcs

SUBSTEPS = 17
"""Physics steps per control step of the reference: 30 Hz at 2 ms is 16.67, so ours makes 17, 17, 16."""


@dataclass(kw_only=True)
class Options:
    """What to measure."""

    copies: int = 32
    """Copies of the environment."""
    threads: int = 0
    """Threads of both; 0 for one per CPU."""
    steps: int = 60
    """Control steps per round; a multiple of 3, so that both make the same number of physics steps per second."""
    rounds: int = 21
    """Alternating rounds."""


def main(options: Options) -> None:
    """Measure and print."""
    threads = options.threads or os.cpu_count() or 1
    # Short episodes, so that some copies start anew in every round.
    envs = rcs.make_vec("PickCuboid", copies=options.copies, threads=threads, max_episode_steps=50)
    rng = np.random.default_rng(0)
    low, high = envs.single_action_space["joints"].low, envs.single_action_space["joints"].high
    actions = [
        {
            "joints": rng.uniform(0.2 * low, 0.2 * high, (options.copies, len(low))),
            "gripper": rng.uniform(0, 1, (options.copies, 1)).astype(np.float32),
        }
        for _ in range(options.steps)
    ]
    envs.reset(seed=0)
    world = envs.scenario.world
    batch = Batch(world.model, options.copies, threads)
    resets, physics = 0, 0

    def run_env() -> float:
        nonlocal resets, physics
        begin = time.perf_counter()
        for action in actions:
            _, _, terminated, truncated, _ = envs.step(action)
            resets += int((terminated | truncated).sum())
            physics += int(world.core.substeps.sum())
        return time.perf_counter() - begin

    def run_batch() -> tuple[float, int]:
        batch.state[:] = world.core.states
        begin = time.perf_counter()
        for _ in actions:
            batch.step(nstep=SUBSTEPS)
        return time.perf_counter() - begin, SUBSTEPS * options.copies * len(actions)

    run_env(), run_batch()
    ratios, env_rates, batch_rates = [], [], []
    for _ in range(options.rounds):
        resets_before, physics = resets, 0
        env_time = run_env()
        made = physics
        batch_time, batch_made = run_batch()
        # Per physics step really made: a copy that starts anew makes none, and every third control step has one less.
        env_rates.append(made / env_time)
        batch_rates.append(batch_made / batch_time)
        ratios.append(env_rates[-1] / batch_rates[-1])
        assert resets > resets_before, "no copy started anew: this is not what the benchmark says it measures"
    envs.close()
    print(
        json.dumps(
            {
                "benchmark": "batch",
                "efficiency": round(median(ratios), 4),
                "copies": options.copies,
                "threads": threads,
                "env_steps_per_s": round(median(env_rates) / (50 / 3)),
                "env_physics_steps_per_s": round(median(env_rates)),
                "batch_physics_steps_per_s": round(median(batch_rates)),
                "episodes_restarted": resets,
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
