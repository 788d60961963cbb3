"""Measure memory, threads and open files of `make_vec` with cameras and resets over a long time.

Random actions in short episodes, each copy starting anew in the step in which it ends, and now and then a reset of some
copies by hand. A line is put through what is in use after the warm-up (least squares).

Prints one JSON object: `mb_per_hour` (slope of the resident memory after the warm-up), `mb` (at the end), `threads` and
`files` (the least and the most after the warm-up), `minutes`, `steps`, `episodes`.
"""

from __future__ import annotations

import json
import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import rcs
from rcs.sim.pixels import Pixels

MB = 1e6


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    minutes: float = 30.0
    """Total duration [min]."""
    warm_up: float = 0.25
    """Fraction of the duration that does not count."""
    copies: int = 24
    """Copies of the environment."""
    threads: int = 2
    """Threads."""
    size: int = 64
    """Edge length of the square frames [px]."""
    cameras: tuple[str, ...] = ("side", "wrist")
    """Cameras of each copy."""
    pictures: bool = False
    """Render frames with matrices by OpenGL instead of pixels for learners."""
    randomisation: bool = False
    """Randomise looks, masses and delays of episodes."""


def main(options: Options) -> None:
    """Measure and print."""
    envs = rcs.make_vec(
        "PickCuboid",
        copies=options.copies,
        threads=options.threads,
        cameras=rcs.Cameras(
            names=options.cameras,
            image_size=options.size,
            pixels=None if options.pictures else Pixels(stack=2, valid_steps=1),
        ),
        randomisation=options.randomisation,
        observe=("privileged", "contacts"),
        collision_reaction=False,
        max_episode_steps=40,
        autoreset="SameStep",
    )
    envs.action_space.seed(0)
    rng = np.random.default_rng(0)
    envs.reset(seed=0)
    begin = last = time.monotonic()
    samples: list[tuple[float, float, int, int]] = []
    steps, episodes = 0, 0
    while last - begin < 60 * options.minutes:
        actions: Any = envs.action_space.sample()
        _, _, terminated, truncated, _ = envs.step(actions)
        steps += options.copies
        episodes += int((terminated | truncated).sum())
        if rng.random() < 0.01:
            envs.reset(options={"reset_mask": rng.random(options.copies) < 0.9})
        now = time.monotonic()
        if now - last > 1.0:
            samples.append((now - begin, *usage()))
            last = now
    envs.close()
    counted = np.array([sample for sample in samples if sample[0] >= options.warm_up * samples[-1][0]])
    slope = float(np.polyfit(counted[:, 0] / 3600, counted[:, 1], 1)[0])
    print(
        json.dumps(
            {
                "benchmark": "soak",
                "mb_per_hour": round(slope, 3),
                "mb": round(float(counted[-1, 1]), 1),
                "largest_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MB, 1),
                "threads": [int(counted[:, 2].min()), int(counted[:, 2].max())],
                "files": [int(counted[:, 3].min()), int(counted[:, 3].max())],
                "minutes": round(samples[-1][0] / 60, 1),
                "steps": steps,
                "episodes": episodes,
                "copies": options.copies,
                "size": options.size,
                "drawn_as": "pictures" if options.pictures else "pixels",
            }
        )
    )


def usage() -> tuple[float, int, int]:
    """Return resident memory [MB], threads and open files of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    threads = len(os.listdir("/proc/self/task"))
    return pages * resource.getpagesize() / MB, threads, len(os.listdir("/proc/self/fd"))


if __name__ == "__main__":
    main(tyro.cli(Options))
