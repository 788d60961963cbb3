"""The ids of `gymnasium.make`, registered by gymnasium itself through this package's entry point."""

from __future__ import annotations

import gymnasium

LABELS = {"fr3": "FR3"}
"""How a robot is written in ids."""


def register() -> None:
    """Register `rcs/<Task>-<Robot>-v0` and `rcs/<Robot>-v0` for every robot; imports no simulator."""
    for robot, label in LABELS.items():
        _register(f"rcs/PickCuboid-{label}-v0", "PickCuboid", robot)
        _register(f"rcs/{label}-v0", "Free", robot)


def _register(name: str, task: str, robot: str) -> None:
    gymnasium.register(
        name,
        entry_point="rcs.setups.make:make",
        vector_entry_point="rcs.setups.ids:make_registered_vec",
        kwargs={"task": task, "robot": robot},
    )


def make_registered_vec(num_envs: int = 1, task: str = "PickCuboid", **options: object) -> object:
    """Make copies for `gymnasium.make_vec(..., vectorization_mode="vector_entry_point")`."""
    from rcs.setups.make import make_vec

    options.pop("render_mode", None)
    return make_vec(task, copies=num_envs, **options)
