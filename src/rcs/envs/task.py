"""The interface of a task, the P' and R' of the paper's wrapper: scene, start of an episode, reward and success."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # labs have an `Area`, and `rcs list` shows them without the simulator
    from rcs.envs.draws import Draws
    from rcs.envs.layers import Where
    from rcs.sim.robot import SimRobot
    from rcs.sim.scene import Scene
    from rcs.sim.world import World


@dataclass(frozen=True, kw_only=True)
class Area:
    """A rectangle on the table in which a task takes place."""

    center: tuple[float, float] = (0.5, 0.0)
    """x, y in the scene [m]; with one robot, its base frame is the scene's."""
    size: tuple[float, float] = (0.30, 0.40)
    """Extent along x and y [m]."""
    object_scale: float = 1.0
    """Size of the objects in proportion to the paper's, for robots that are smaller."""


@dataclass(kw_only=True)
class Outcome:
    """What a task says of the present state. Arrays have the world's leading shape."""

    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    info: dict[str, NDArray[Any]] = field(default_factory=dict)
    """What agents and people may want to know; `success`, bool, is there where there is something to judge."""


class Task(ABC):
    """A task on one world. It keeps what it must remember per copy."""

    instruction: str = ""
    """What a language-conditioned policy is told."""

    def __init__(self, area: Area) -> None:
        """Take place in an area."""
        self.area = area

    def furnish(self, scene: Scene) -> None:  # noqa: B027  an empty scene is a fine scene
        """Add the task's objects to a scene before it is compiled."""

    def objects(self) -> list[str]:
        """Return the names of the bodies that the task is about: those whose size, mass and colour may vary."""
        return []

    @abstractmethod
    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Look up what the task reads and writes, once the scene is compiled."""

    @abstractmethod
    def reset(self, draws: Draws, where: Where) -> None:
        """Write the start of an episode into the state of some copies.

        Args:
            draws: Random numbers for exactly these copies.
            where: Which copies; `...` for all, or for the only one.
        """

    @abstractmethod
    def evaluate(self) -> Outcome:
        """Judge the present state of all copies. Called once per step."""

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the info of the first observation of an episode, of all copies."""
        return {}

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return where the objects that the task is about are: poses in the scene by name, (*leading, 7) [m], xyzw."""
        return {}

    def place(self, poses: Mapping[str, NDArray[np.float64]], where: Where) -> None:
        """Put objects somewhere by writing the state, at rest; only called after `reset` and before the first step.

        Args:
            poses: Poses in the scene by names of `object_poses`, of exactly these copies, (*leading, 7) [m], xyzw.
            where: Which copies; `...` for all, or for the only one.
        """
        raise NotImplementedError(f"{type(self).__name__} tells where its objects are but cannot place them.")
