"""The interface of a task, the P' and R' of the paper's wrapper: scene, start of an episode, reward and success."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Positive, Record

from rcs.errors import InvalidSetup

if TYPE_CHECKING:  # labs have an `Area`, and `rcs list` shows them without the simulator
    from rcs.envs.episode_random import EpisodeRandom
    from rcs.envs.layers import CopyIndex
    from rcs.sim.robot import SimRobot
    from rcs.sim.scene import RobotPlacement, Scene
    from rcs.sim.world import World


Circle = tuple[NDArray[np.float64], NDArray[np.float64] | float]
"""A circle on the table that stays free: its middle in the scene, (*leading, 2) or longer [m], and radius [m]."""

TRIES = 16
"""Draws of a place apart from another one: with the built-in areas, one is far enough in all but 1 of 10^4 episodes."""


class Area(Record):
    """A rectangle on the table in which a task takes place."""

    center: tuple[float, float] = (0.5, 0.0)
    """x, y in the scene [m]; with one robot, its base frame is the scene's."""
    size: tuple[float, float] = (0.30, 0.40)
    """Extent along x and y [m]."""
    object_scale: Positive = 1.0
    """Size of the objects in proportion to the paper's, for robots that are smaller."""
    large_center: tuple[float, float] | None = None
    """Centre of a larger rectangle, all of which the robot reaches from above, for harder tasks; None for `center`."""
    large_size: tuple[float, float] | None = None
    """Its extent along x and y [m]; None if there is no larger one."""

    def enlarged(self) -> Area:
        """Return the larger rectangle.

        Raises:
            InvalidSetup: There is none.
        """
        if self.large_size is None:
            raise InvalidSetup("This lab has no large area; set `large_size` of its Area, or use area='lab'.")
        return dataclasses.replace(self, center=self.large_center or self.center, size=self.large_size)

    def draw_place(self, random: EpisodeRandom, max_yaw: float = np.pi) -> NDArray[np.float64]:
        """Return random x, y in the scene [m] and a yaw of up to `max_yaw` to either side [rad], (*leading, 3)."""
        half, center = np.array(self.size) / 2, np.array(self.center)
        return random.uniform(np.append(center - half, -max_yaw), np.append(center + half, max_yaw))

    def draw_apart(self, random: EpisodeRandom, place: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
        """Return another random place and yaw like `draw_place`, (*leading, 3).

        Args:
            random: Random numbers.
            place: The place to keep away from: x, y [m] first, (*leading, 3).
            distance: Least distance from it [m]; where none of `TRIES` draws has it, the farthest counts.
        """
        tries = np.stack([self.draw_place(random) for _ in range(TRIES)], axis=-2)
        offset = tries - place[..., None, :]
        apart = np.sqrt(offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1])
        best = np.argmax(np.minimum(apart, distance), axis=-1)  # the first that is far enough, or the farthest
        return np.take_along_axis(tries, best[..., None, None], axis=-2)[..., 0, :]


@dataclass(kw_only=True)
class Judgement:
    """A task's verdict on the present state, which the reward is made of. Arrays have the world's leading shape."""

    success: NDArray[np.bool_] | None = None
    """Whether the task is done, which `info` reports too; None where there is nothing to judge."""
    progress: NDArray[np.float64] | None = None
    """How far the task has come, 0 … 1: the potential of the shaped reward; None for no more to go by than success."""
    is_placed: NDArray[np.bool_] | None = None
    """Whether all is in place, so that only time and rest are left to success; the dense reward then pays for arms at
    rest. None if the task does not say."""
    terminated: NDArray[np.bool_] | None = None
    """Whether the episode ends here; None if it does at success, and only then."""
    reward: NDArray[np.float64] | None = None
    """A reward of the task's own, in the place of that of the setup; None for that of the setup."""
    info: dict[str, NDArray[Any]] = field(default_factory=dict)
    """Info for agents and people."""

    def __post_init__(self) -> None:
        """Tell success in `info`."""
        if self.success is not None:
            self.info = {"success": self.success, **self.info}
        if self.terminated is None:
            self.terminated = self.success


class Task(ABC):
    """A task on one world; it keeps its memory per copy."""

    memory: ClassVar[tuple[str, ...]] = ()
    """Names of the attributes in which the task remembers something between steps; see `Layer.memory`."""

    instruction: str = ""
    """The instruction for language-conditioned policies."""

    expert: ClassVar[str | type | None] = None
    """The agent that can do the task: its class, `module:Class`, or the name of an entry point of `rcs.agents`."""

    placer: ClassVar[str | type | None] = None
    """The script that sets the object in the gripper at `info["goal"]`, for tasks with an option `placed_by`."""

    class Options(Record):
        """Options of every task; a task with more options subclasses this as its own `Options`."""

        hints: ClassVar[Mapping[str, str]] = {
            "reward": "It is no option of a task but of the setup: reward='sparse', as `rcs.Setup` says."
        }

    def __init__(self, area: Area, options: Options | Mapping[str, Any] | None = None) -> None:
        """Set area and options.

        Args:
            area: Area in which objects may lie.
            options: Options of the task's class `Options`, or some of its fields by name; None for its defaults.

        Raises:
            InvalidSetup: An option is unknown, or a value is not valid.
        """
        self.area = area
        self.options = self.parse_options(options)

    @classmethod
    def parse_options(cls, values: Options | Mapping[str, Any] | None) -> Options:
        """Return checked options of this task.

        Args:
            values: Options of this task, or some of their fields by name; None for the defaults.

        Raises:
            InvalidSetup: The options are of another task, one is unknown, or a value is not valid.
        """
        if isinstance(values, cls.Options):
            return values
        if not isinstance(values, Mapping | None):
            raise InvalidSetup(
                f"The options of the task {cls.__name__} are {values!r}; valid is a {cls.__name__}.Options, a mapping "
                "with some of its fields, or None."
            )
        try:
            return cls.Options.from_json(values or {})
        except InvalidSetup as err:
            raise InvalidSetup(f"The task {cls.__name__}: {err}") from err

    def furnish(self, scene: Scene) -> None:  # noqa: B027  an empty scene is a fine scene
        """Add the task's objects to a scene before it is compiled."""

    def equip(self, scene: Scene, robots: tuple[RobotPlacement, ...]) -> None:  # noqa: B027  most robots carry nothing
        """Add what robots carry, once they are in the scene."""

    def objects(self) -> list[str]:
        """Return the names of the task's bodies, whose size, mass and colour may vary."""
        return []

    @abstractmethod
    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Look up what the task reads and writes, once the scene is compiled."""

    @abstractmethod
    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Write the start of an episode into the state of some copies.

        Args:
            random: Random numbers for exactly these copies.
            where: The copies; `...` for all, or for the only one.
        """

    @abstractmethod
    def evaluate(self) -> Judgement:
        """Judge the present state of all copies.

        Called at the start of an episode and after every step; with copies that start at different times, it may see
        the same state of the others twice, and must then judge the same.
        """

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the info of the first observation of an episode, of all copies."""
        return {}

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return the poses of the task's objects in the scene by name, (*leading, 7) [m], xyzw."""
        return {}

    def occupied(self) -> list[Circle]:
        """Return the circles in which the last `reset` has put other things than objects, of exactly its copies."""
        return []

    def place(self, poses: Mapping[str, NDArray[np.float64]], where: CopyIndex) -> None:
        """Put objects at given poses, at rest, by writing the state; called only between `reset` and the first step.

        Args:
            poses: Poses in the scene by names of `object_poses`, of exactly these copies, (*leading, 7) [m], xyzw.
            where: The copies; `...` for all, or for the only one.
        """
        raise NotImplementedError(f"{type(self).__name__} has poses of its objects but cannot set them.")
