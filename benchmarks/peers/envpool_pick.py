"""PandaPickCube of EnvPool (C++, MuJoCo Playground's model): 16 copies on two threads. It has no pictures."""

from __future__ import annotations

import envpool
import numpy as np
from rate import report

COPIES = 16
CONTROL, PHYSICS = 0.02, 0.005
"""Control period and physics step [s], from the configuration of the task in EnvPool and MuJoCo Playground."""


def main() -> None:
    """Measure and print."""
    envs = envpool.make_gymnasium("PandaPickCube-v1", num_envs=COPIES, num_threads=2)
    envs.reset()
    rng = np.random.default_rng(0)
    low, high = envs.action_space.low, envs.action_space.high
    actions = [rng.uniform(low, high, (COPIES, *low.shape)).astype(np.float32) for _ in range(100)]
    turn = 0

    def step() -> None:
        nonlocal turn
        envs.step(actions[turn % len(actions)])
        turn += 1

    report(step, copies=COPIES, control_period=CONTROL, physics_step=PHYSICS, pixels=0)


if __name__ == "__main__":
    main()
