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

ROBOTS = {
    "fr3": ("FR3", ("Free", "PickCuboid", "Place", "StackCuboid", "Push")),
    "dual_fr3": ("DualFR3", ("Free", "LiftBar")),
    "so101": ("SO101", ("Free", "PickCuboid", "Place", "StackCuboid", "Push")),
    "ur5e": ("UR5e", ("Free", "PickCuboid", "Place", "StackCuboid", "Push")),
    "xarm7": ("XArm7", ("Free", "PickToy", "Push")),
}
"""Word in ids, and tasks, of the robots of this package."""

BUILT_IN = {
    f"rcs/{word}-v0" if task == "Free" else f"rcs/{task}-{word}-v0": (task, robot)
    for robot, (word, tasks) in ROBOTS.items()
    for task in tasks
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
