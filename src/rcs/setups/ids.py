"""The ids of `gymnasium.make`. Importing `rcs` registers the built-in ones, without a look at other packages.

A package adds ids through the entry-point group `rcs.ids`, such as `PickCuboid-MyRobot-v0 = "my_robot"`: the name is
what follows `rcs/` in the id, its first word is the task, and the value is the robot. `rcs/MyRobot-v0` has no task.
Importing `rcs.installed` registers those, as `gymnasium.make("rcs.installed:rcs/PickCuboid-MyRobot-v0")` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as register_id
from gymnasium.envs.registration import registry

if TYPE_CHECKING:
    from rcs.envs.vector import VecEnv

EPISODE_STEPS = 300
"""Gymnasium truncates an episode after this many steps; `gymnasium.make(..., max_episode_steps=...)` changes it."""

BUILT_IN = {
    "rcs/FR3-v0": ("Free", "fr3"),
    "rcs/PickCuboid-FR3-v0": ("PickCuboid", "fr3"),
    "rcs/Place-FR3-v0": ("Place", "fr3"),
    "rcs/StackCuboid-FR3-v0": ("StackCuboid", "fr3"),
    "rcs/DualFR3-v0": ("Free", "dual_fr3"),
    "rcs/LiftBar-DualFR3-v0": ("LiftBar", "dual_fr3"),
    "rcs/SO101-v0": ("Free", "so101"),
    "rcs/PickCuboid-SO101-v0": ("PickCuboid", "so101"),
    "rcs/Place-SO101-v0": ("Place", "so101"),
    "rcs/StackCuboid-SO101-v0": ("StackCuboid", "so101"),
    "rcs/UR5e-v0": ("Free", "ur5e"),
    "rcs/PickCuboid-UR5e-v0": ("PickCuboid", "ur5e"),
    "rcs/Place-UR5e-v0": ("Place", "ur5e"),
    "rcs/StackCuboid-UR5e-v0": ("StackCuboid", "ur5e"),
    "rcs/XArm7-v0": ("Free", "xarm7"),
    "rcs/PickToy-XArm7-v0": ("PickToy", "xarm7"),
    "rcs/Push-FR3-v0": ("Push", "fr3"),
    "rcs/Push-SO101-v0": ("Push", "so101"),
    "rcs/Push-UR5e-v0": ("Push", "ur5e"),
    "rcs/Push-XArm7-v0": ("Push", "xarm7"),
}
"""Task and robot of the ids of this package."""


def ids() -> dict[str, tuple[str, str]]:
    """Return task and robot by id, of this package and of all that are installed; imports none of them."""
    found = dict(BUILT_IN)
    for entry in entry_points(group="rcs.ids"):
        task, _, rest = entry.name.partition("-")
        found[f"rcs/{entry.name}"] = (task if "-" in rest else "Free", entry.value)
    return found


def tasks_of(robot: str) -> list[str]:
    """Return the tasks that have an id with a robot."""
    return [task for task, other in ids().values() if other == robot and task != "Free"]


def register(some: Mapping[str, tuple[str, str]] = BUILT_IN) -> None:
    """Register ids with Gymnasium; imports no simulator."""
    for name, (task, robot) in some.items():
        if name not in registry:
            register_id(
                name,
                entry_point="rcs.setups.ids:make_registered",
                vector_entry_point="rcs.setups.ids:make_registered_vec",
                kwargs={"task": task, "robot": robot},
                max_episode_steps=EPISODE_STEPS,
            )


def make_registered(task: str, **options: Any) -> Any:
    """Make an environment for `gymnasium.make`."""
    from rcs.setups.make import make

    options.setdefault("max_episode_steps", None)
    return make(task, **options)


def make_registered_vec(num_envs: int = 1, task: str = "PickCuboid", **options: Any) -> VecEnv:
    """Make copies for `gymnasium.make_vec(..., vectorization_mode="vector_entry_point")`."""
    from rcs.setups.make import make_vec

    return make_vec(task, copies=num_envs, **options)
