"""Measure rates of steps and of samples; shared by the programs of this folder, which run in Pythons without rcs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

HORIZON, BATCH = 16, 64
"""Actions in a sample, and samples in a batch."""


def report(step: Callable[[], Any], *, copies: int, control_period: float, physics_step: float, **more: Any) -> None:
    """Warm up, step for two seconds, and print one JSON line.

    Args:
        step: Makes one control step of all copies, with random actions and new episodes where due.
        copies: Number of environments in a step.
        control_period: Simulated time of a control step [s].
        physics_step: Time step of the physics [s].
        more: Further values to print.
    """
    warm = time.perf_counter() + 1.0
    while time.perf_counter() < warm:
        step()
    steps, start = 0, time.perf_counter()
    while (seconds := time.perf_counter() - start) < 2.0:
        step()
        steps += copies
    rate = steps / seconds
    print(
        json.dumps(
            {
                "steps_per_s": rate,
                "physics_steps_per_s": rate * control_period / physics_step,
                "simulated_s_per_s": rate * control_period,
                "control_hz": 1 / control_period,
                "physics_hz": 1 / physics_step,
                "copies": copies,
                **more,
            }
        )
    )


def report_samples(reader: str, dataset: Any, *, workers: int, column: str) -> None:
    """Load batches in random order for ten seconds, after a first one, and print one JSON line.

    Args:
        reader: Name of the reader.
        dataset: A dataset for `torch.utils.data.DataLoader`, whose samples have `HORIZON` actions.
        workers: Workers of the loader.
        column: A column of a batch, whose rows are counted.
    """
    from torch.utils.data import DataLoader

    loader: Any = DataLoader(
        dataset, batch_size=BATCH, shuffle=True, num_workers=workers, persistent_workers=workers > 0
    )
    batches = (batch for _ in iter(int, 1) for batch in loader)
    next(batches)
    samples, start = 0, time.perf_counter()
    while (seconds := time.perf_counter() - start) < 10.0:
        samples += len(next(batches)[column])
    print(json.dumps({"reader": reader, "samples_per_second": samples / seconds}))
