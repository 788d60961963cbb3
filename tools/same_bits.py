"""Compare the bits of two checkouts by hashes of all actions, observations and rewards of seeded episodes.

    python tools/same_bits.py [--episodes 20] [--physics-step 0.002] [--only PickCuboid:fr3 ...] > one.txt

One line per task and robot, with the experts of the tasks; compare the files of two checkouts with `diff`.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

import rcs
from rcs.agents import agent_for

SETUPS: dict[str, dict[str, Any]] = {
    "PickCuboid:fr3": {"observe": ("torques", "wrench", "contacts", "privileged"), "task_options": {"distractors": 4}},
    "PickCuboid:ur5e": {"control": "xyzrpy", "reward": "dense", "task_options": {"pose": "any", "edges": "random"}},
    "PickCuboid:xarm7": {"end_effector": "robotiq_2f85", "control": "tquat", "relative": "absolute"},
    "PickCuboid:so101": {"stepping": "sync", "randomisation": "default"},
    "Place:fr3": {"randomisation": "strong"},
    "Place:so101": {},
    "Place:ur5e": {"reward": "dense"},
    "StackCuboid:fr3": {"reward": "dense"},
    "Push:fr3": {"control": "twist"},
    "PickToy:xarm7": {"end_effector": "robotiq_2f85", "randomisation": "mild"},
    "LiftBar:dual_fr3": {"observe": ("privileged",), "reward": "dense"},
}
"""Options by task and robot, so that all controls, both steppings, rewards and randomisations are among them."""


def feed(digest: Any, value: Any) -> None:
    """Add a value, in any nesting, to a hash."""
    if isinstance(value, Mapping):
        for key in sorted(value):
            digest.update(key.encode())
            feed(digest, value[key])
    else:
        digest.update(np.ascontiguousarray(value).tobytes())


def hashed(name: str, episodes: int, physics_step: float) -> str:
    """Return the hash of the episodes of a task on a robot, and how many succeed."""
    task, robot = name.split(":")
    digest, successes, steps = hashlib.sha256(), 0, 0
    with rcs.make(task, robot=robot, physics_step=physics_step, **SETUPS[name]) as env:
        agent = agent_for(env)
        for seed in range(episodes):
            observation, info = env.reset(seed=seed)
            agent.reset(observation, info)
            feed(digest, observation)
            is_over = False
            while not is_over:
                action = agent.act(observation, info)
                observation, reward, terminated, truncated, info = env.step(action)
                for value in (action, observation, reward):
                    feed(digest, value)
                is_over, steps = terminated or truncated, steps + 1
            successes += bool(info["success"])
    return f"{digest.hexdigest()[:16]} {steps} steps {successes} of {episodes}"


def main() -> None:
    """Hash and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--physics-step", type=float, default=0.002)
    parser.add_argument("--only", nargs="+", choices=SETUPS, default=list(SETUPS), metavar="TASK:ROBOT")
    given = parser.parse_args()
    for name in given.only:
        print(name, hashed(name, given.episodes, given.physics_step), flush=True)


if __name__ == "__main__":
    main()
