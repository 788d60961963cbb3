"""Measure the force with which simulated arms hit a table before their collision reaction stops them.

    python benchmarks/impact.py --robot fr3

An impact is over within a few steps of the physics, and no arm reacts before it has felt one. The force is that of
MuJoCo's contacts in every step of the physics; it depends on how stiff these contacts are.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

import rcs

SPEEDS = (0.02, 0.05, 0.1, 0.25)
"""Speeds of the tool on its way down [m/s]."""
LIMIT = 1.0
"""Longest observed contact [s]."""


def hit(robot: str, speed: float, physics_step: float = 0.002, **fields: Any) -> dict[str, float | str]:
    """Send the open gripper straight down; return the peak force [N] and the times of peak and reaction [s]."""
    form: dict[str, Any] = {"control": "tquat", "relative": False, "max_episode_steps": None, **fields}
    # A control step is one of the physics, so that none of these is missed.
    env: Any = rcs.make("PickCuboid", robot=robot, frequency=1 / physics_step, physics_step=physics_step, **form)
    world = env.simulation.world
    arm = world.subtree_flags(env.simulation.robots[0].placement.base_body)
    force = world.core.read_force(arm, 1 - arm)
    observation, _ = env.reset(seed=0)
    target, period = observation["tquat"].copy(), world.period
    forces: list[float] = []
    truncated, first, info = False, None, {}
    while not truncated and (first is None or len(forces) - first < LIMIT / period):
        target[2] -= speed * period
        *_, truncated, info = env.step({"tquat": target, "gripper": np.ones(1, np.float32)})
        forces.append(float(world.forces[force]))
        if first is None and forces[-1] > 0:
            first = len(forces) - 1
    env.close()
    if first is None:
        return {"robot": robot, "speed": speed, "peak_force": 0.0}
    peak = int(np.argmax(forces))
    return {
        "robot": robot,
        "speed": speed,
        "peak_force": round(forces[peak]),
        "peak_after": round((peak - first) * period, 4),
        "reaction_after": round((len(forces) - 1 - first) * period, 4) if truncated else float("nan"),
        "reason": "; ".join(info.get("faults", {}).values()),
    }


def main() -> None:
    """Print a line for each speed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="fr3", help="name of a robot")
    parser.add_argument("--speeds", type=float, nargs="+", default=SPEEDS, help="of the tool [m/s]")
    chosen = parser.parse_args()
    for speed in chosen.speeds:
        print(json.dumps(hit(chosen.robot, speed)))


if __name__ == "__main__":
    main()
