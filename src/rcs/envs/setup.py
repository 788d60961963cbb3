"""A setup: everything that defines an environment, as one frozen record that can be stored, sent and compared."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal, get_args

from rcs.envs.spaces import Control
from rcs.errors import InvalidSetup
from rcs.sim.camera import Quality
from rcs.sim.world import Mode

Relative = Literal["last_step", "origin", "absolute"]
"""What an arm's action is added to; `absolute`: to nothing."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """An environment by names and numbers. `to_json` and `from_json` are inverse to each other."""

    task: str = "PickCuboid"
    """Name of the task; `Free` for none."""
    robot: str = "fr3"
    """Name of the robot."""
    end_effector: str | None = None
    """Name of the gripper; None for the robot's usual one."""
    cameras: tuple[str, ...] = ()
    """Names of camera mounts of the robot's lab, such as `wrist` and `side`; more cameras, slower steps."""
    size: tuple[int, int] = (224, 224)
    """Width and height of every frame [px]."""
    depth: bool = False
    """Whether frames carry depth; costs about a third of a frame's time."""
    quality: Quality = "fast"
    """`full` draws shadows, reflections and smooth edges, and is about fifty times slower without a GPU."""
    control: Control = "joints"
    """What an action says of the arm: joint positions, or the TCP's pose with a quaternion or with roll, pitch, yaw."""
    relative: Relative = "last_step"
    """What an arm's action is added to: the last target, an origin that the user sets, or nothing."""
    binary_gripper: bool = True
    """Whether the gripper only opens and closes fully."""
    frequency: float = 30.0
    """Control steps per second [Hz]."""
    mode: Mode = "async"
    """How long a step lasts: one control period of simulated time, until arrived, or one period of the wall clock."""
    max_episode_steps: int | None = 300
    """An episode is truncated after this many steps; None for no limit."""
    physics_step: float = 0.002
    """Time step of the physics [s]; longer is faster and grasps slip."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has a value that makes no sense; the message says what is valid.
        """
        for name in ("task", "robot"):
            if not isinstance(getattr(self, name), str):
                raise InvalidSetup(f"{name} is {getattr(self, name)!r}; it must be a name.")
        object.__setattr__(self, "cameras", _names("cameras", self.cameras))
        object.__setattr__(self, "size", _size(self.size))
        relative: Any = self.relative
        if isinstance(relative, bool):
            object.__setattr__(self, "relative", "last_step" if relative else "absolute")
        for name, options in (("control", Control), ("relative", Relative), ("mode", Mode), ("quality", Quality)):
            value = getattr(self, name)
            if value not in get_args(options):
                raise InvalidSetup(f"{name} is {value!r}; valid: {', '.join(map(repr, get_args(options)))}.")
        if not 0 < self.frequency <= 1 / self.physics_step + 1e-9:
            raise InvalidSetup(f"frequency is {self.frequency} Hz; valid is above 0 and up to {1 / self.physics_step:g} Hz.")
        if not 0 < self.physics_step <= 0.01:
            raise InvalidSetup(f"physics_step is {self.physics_step} s; valid is above 0 and up to 0.01 s.")
        if self.max_episode_steps is not None and self.max_episode_steps < 1:
            raise InvalidSetup(f"max_episode_steps is {self.max_episode_steps}; valid is 1 and more, or None.")

    def to_json(self) -> dict[str, Any]:
        """Return the setup as JSON values."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in dataclasses.asdict(self).items()}

    @staticmethod
    def from_json(values: dict[str, Any]) -> Setup:
        """Return the setup that `to_json` wrote.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        fields = {field.name for field in dataclasses.fields(Setup)}
        if unknown := sorted(set(values) - fields):
            raise InvalidSetup(f"A setup has no fields {unknown}; it has {sorted(fields)}.")
        return Setup(**values)


def _names(field: str, value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        raise InvalidSetup(f"{field} is the text {value!r}; give a tuple of names, such as ({value!r},).")
    names = tuple(value)
    if not all(isinstance(name, str) for name in names) or len(set(names)) != len(names):
        raise InvalidSetup(f"{field} is {value!r}; it must be different names.")
    return names


def _size(value: Any) -> tuple[int, int]:
    if isinstance(value, int):
        value = (value, value)
    size = tuple(value)
    if len(size) != 2 or not all(isinstance(edge, int) and 1 <= edge <= 4096 for edge in size):
        raise InvalidSetup(f"size is {value!r}; valid is one number or (width, height) of 1 to 4096 px.")
    return size
