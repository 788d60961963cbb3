"""Measure the cost of a complete step of `make_vec` on top of MuJoCo's own batch stepping of the same model.

A step checks and maps actions through the layers, and includes the arms' trajectories, physics, observation, reward and
autoreset, with the settings of learners: observed object poses and contacts, and no end of episodes at collisions.

The reference is `mujoco.batch.Batch.step` alone, with the same threads. Each of its control steps starts in the states
in which ours started, holds the controls with which ours ended, and makes as many physics steps, so that motions and
contacts are equal. It excludes all costs of trajectories: the plan of each step, the controls of each physics step, the
torques of accelerations; and writing the states is not timed. (With the controls of the previous step, the arms would
come to rest, which makes the physics 3 % cheaper.)

Rounds alternate; the ratio is the median over rounds. A copy that starts an episode makes no physics step, so rates
count only actual physics steps.

Prints one JSON object: `efficiency` (ours over the reference), `env_steps_per_s`, `env_physics_steps_per_s`,
`batch_physics_steps_per_s`.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np
import tyro
from mujoco.batch import Batch

import rcs

SUBSTEPS = 17, 17, 16
"""Physics steps of three control steps: 30 Hz at 2 ms is 16.67."""
SHARE = 0.2
"""Fraction of the range of joint actions in use. With the full range, arms would soon lie on the table."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    copies: int = 32
    """Copies of the environment."""
    threads: int = 0
    """Threads of both; 0 for one per CPU that this process may use."""
    robot: str = "fr3"
    """The robot."""
    control: Literal["joints", "tquat", "xyzrpy", "twist"] = "joints"
    """Format of actions."""
    setup: Literal["learning", "plain"] = "learning"
    """`learning` observes poses of objects and contacts and goes on after collisions; `plain` has the defaults."""
    steps: int = 60
    """Control steps per round, a multiple of 3."""
    rounds: int = 21
    """Alternating rounds."""


def main(options: Options) -> None:
    """Measure and print."""
    threads = options.threads or len(os.sched_getaffinity(0))
    is_learning = options.setup == "learning"
    # Short episodes, so that some copies start an episode in every round.
    envs = rcs.make_vec(
        "PickCuboid",
        robot=options.robot,
        copies=options.copies,
        threads=threads,
        max_episode_steps=50,
        control=options.control,
        observe=("privileged", "contacts") if is_learning else (),
        collision_reaction=not is_learning,
    )
    rng = np.random.default_rng(0)
    space = envs.single_action_space[options.control]
    share = SHARE if options.control == "joints" else 1.0
    actions = [
        {
            options.control: rng.uniform(share * space.low, share * space.high, (options.copies, *space.shape)),
            "gripper": rng.uniform(0, 1, (options.copies, 1)).astype(np.float32),
        }
        for _ in range(options.steps)
    ]
    envs.reset(seed=0)
    world = envs.simulation.world
    batch = Batch(world.model, options.copies, threads)
    starts = np.empty((options.steps, *world.core.states.shape))
    controls = np.empty((options.steps, *world.ctrl.shape))
    resets = 0

    def run_env() -> float:
        """Return physics steps per second."""
        nonlocal resets
        taken, made = 0.0, 0
        for action, start, control in zip(actions, starts, controls, strict=True):
            start[:] = world.core.states
            begin = time.perf_counter()
            _, _, terminated, truncated, _ = envs.step(action)
            taken += time.perf_counter() - begin
            control[:] = world.ctrl
            resets += int((terminated | truncated).sum())
            made += int(world.core.substeps.sum())
        return made / taken

    def run_batch() -> float:
        """Return physics steps per second."""
        taken = 0.0
        for i, (start, control) in enumerate(zip(starts, controls, strict=True)):
            batch.state[:] = start
            batch.ctrl[:] = control
            begin = time.perf_counter()
            batch.step(nstep=SUBSTEPS[i % 3])
            taken += time.perf_counter() - begin
        return sum(SUBSTEPS) * options.steps // 3 * options.copies / taken

    run_env(), run_batch()
    rates = []
    for _ in range(options.rounds):
        resets_before = resets
        rates.append((run_env(), run_batch()))
        assert resets > resets_before, "no copy has started an episode: the result would not be representative"
    envs.close()
    ours, reference = (median(side) for side in zip(*rates, strict=True))
    print(
        json.dumps(
            {
                "benchmark": "batch",
                "efficiency": round(median(own / other for own, other in rates), 4),
                "copies": options.copies,
                "threads": threads,
                "robot": options.robot,
                "control": options.control,
                "setup": options.setup,
                "env_steps_per_s": round(ours / (sum(SUBSTEPS) / len(SUBSTEPS))),
                "env_physics_steps_per_s": round(ours),
                "batch_physics_steps_per_s": round(reference),
                "episodes_restarted": resets,
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
