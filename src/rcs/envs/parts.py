"""The parts that an environment is put together from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rcs.envs.gates.gate import Gate
from rcs.envs.layers import Layer
from rcs.envs.observer import Observer
from rcs.envs.setup import Setup
from rcs.envs.task import Task
from rcs.envs.variation.clutter import Clutter
from rcs.hardware.devices import Devices
from rcs.robots.mount import Obstacle
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.tactile_mounts import TactilePlacement


@dataclass(frozen=True, kw_only=True)
class Parts:
    """The parts of an environment: those that a setup names, looked up, and those that a user adds."""

    setup: Setup
    """The setup itself: numbers and options."""
    robots: tuple[RobotPlacement, ...]
    """Each within the limits of its device, where it has one."""
    cameras: tuple[CameraPlacement, ...]
    tactile: tuple[TactilePlacement, ...] = ()
    task: Task
    clutter: Clutter | None = None
    """Things that lie about besides the objects of the task; None for nothing."""
    obstacles: Mapping[str, Obstacle] = field(default_factory=dict[str, Obstacle])
    """Boxes of the lab that stand still, by name."""
    devices: Devices = field(default_factory=Devices)
    """Real devices; all else is simulated."""
    layers: Mapping[str, Sequence[Layer]] = field(default_factory=dict[str, Sequence[Layer]])
    """The user's own layers by robot, on top of those of the setup."""
    gates: Sequence[Gate] = ()
    observers: Sequence[Observer] = ()
    now: Callable[[], float] | None = None
    """Returns the monotonic time [s]; None for the host's."""
    sleep: Callable[[float], None] | None = None
    """Waits for some seconds of that time; None for the host's."""

    def __post_init__(self) -> None:
        """Narrow the limits of every robot to those of its device.

        Raises:
            InvalidSetup: A device is none of this robot: its joints are of another number or have other ranges.
        """
        arms = self.devices.arms
        robots = tuple(
            replace(robot, arm=robot.arm.within(arms[robot.name].limits, arms[robot.name].name))
            if robot.name in arms
            else robot
            for robot in self.robots
        )
        object.__setattr__(self, "robots", robots)
