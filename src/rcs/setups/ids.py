"""The ids of `gymnasium.make`, registered when `rcs` is imported; the simulator is imported when one is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as register_id
from gymnasium.envs.registration import registry

if TYPE_CHECKING:
    from rcs.envs.vector import VecEnv

LABELS = {"fr3": "FR3"}
"""How a robot is written in ids."""


def ids() -> dict[str, tuple[str, str]]:
    """Return task and robot by id: `rcs/<Task>-<Robot>-v0`, and `rcs/<Robot>-v0` for no task."""
    found: dict[str, tuple[str, str]] = {}
    for robot, label in LABELS.items():
        found[f"rcs/PickCuboid-{label}-v0"] = ("PickCuboid", robot)
        found[f"rcs/{label}-v0"] = ("Free", robot)
    return found


def register() -> None:
    """Register all ids; imports no simulator."""
    for name, (task, robot) in ids().items():
        if name in registry:
            continue
        register_id(
            name,
            entry_point="rcs.setups.make:make",
            vector_entry_point="rcs.setups.ids:make_registered_vec",
            kwargs={"task": task, "robot": robot},
        )


def make_registered_vec(num_envs: int = 1, task: str = "PickCuboid", **options: Any) -> VecEnv:
    """Make copies for `gymnasium.make_vec(..., vectorization_mode="vector_entry_point")`."""
    from rcs.setups.make import make_vec

    options.pop("render_mode", None)
    return make_vec(task, copies=num_envs, **options)
