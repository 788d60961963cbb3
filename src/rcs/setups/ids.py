"""The ids of `gymnasium.make`, registered when `rcs` is imported; the simulator is imported when one is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as register_id
from gymnasium.envs.registration import registry

if TYPE_CHECKING:
    from rcs.envs.vector import VecEnv

LABS: dict[str, tuple[str, tuple[str, ...]]] = {
    "fr3": ("FR3", ("PickCuboid",)),
    "dual_fr3": ("DualFR3", ("LiftBar",)),
    "so101": ("SO101", ("PickCuboid",)),
    "ur5e": ("UR5e", ("PickCuboid",)),
    "xarm7": ("XArm7", ("PickToy",)),
}
"""How each lab is written in ids, and its tasks. A test compares this with the labs, which are not imported for it."""


def ids() -> dict[str, tuple[str, str]]:
    """Return task and robot by id: `rcs/<Task>-<Robot>-v0`, and `rcs/<Robot>-v0` for no task."""
    found: dict[str, tuple[str, str]] = {}
    for robot, (label, tasks) in LABS.items():
        found.update({f"rcs/{task}-{label}-v0": (task, robot) for task in tasks})
        found[f"rcs/{label}-v0"] = ("Free", robot)
    return found


def add(robot: str, label: str, tasks: tuple[str, ...]) -> None:
    """Register the ids of another package's lab; to be called when that package is imported.

    `gymnasium.make("my_robot:rcs/PickCuboid-MyRobot-v0")` imports the package `my_robot` first.

    Args:
        robot: Name of the lab.
        label: How it is written in ids, such as `MyRobot`.
        tasks: Names of its tasks.
    """
    LABS[robot] = (label, tasks)
    register()


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
