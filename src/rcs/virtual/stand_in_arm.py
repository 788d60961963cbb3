"""A simulated arm behind the interface of a real one, with the delay and the noise that real ones have."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.fake import limits_of
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.sim.scene import RobotPlacement
from rcs.sim.timed_world import SMOOTHING, TimedWorld

ARRIVED = 2e-3
"""A joint that is nearer to its target than this has arrived [rad]."""
STILL = 5e-3
"""A joint that is slower than this stands still [rad/s]."""

_NAME = "arm"


class StandInArm(Arm):
    """An arm with physics that obeys `delay` seconds late and measures its joints with noise.

    It is simulated up to the present moment of its clock whenever it is asked or told something, so it moves in real
    time without a thread. `freeze` has it stand still without a word, as a robot does whose controller hangs;
    `lose_link` and `restore` are those of the fakes.
    """

    def __init__(
        self,
        about: ArmDescription,
        *,
        gripper: GripperDescription | None = None,
        delay: float = 0.02,
        noise: float = 0.0,
        seed: int = 0,
        smoothing: float = SMOOTHING,
        clock: Callable[[], float] = time.monotonic,
        name: str = "stand-in",
    ) -> None:
        """Describe the arm; nothing is simulated before `open`, which has it stand at home.

        Args:
            about: The arm's figures.
            gripper: What it carries, for its mass; None for nothing.
            delay: Time between a command and the motion that it causes [s].
            noise: Standard deviation of every measured joint [rad].
            seed: Of the noise.
            smoothing: Time constant of each of the two low-passes that smooth targets [s].
            clock: Returns the time [s].
            name: Name in messages.

        Raises:
            InvalidSetup: The delay or the noise is negative, or not finite.
        """
        for what, value, unit in (("delay", delay, "s"), ("noise", noise, "rad")):
            if not (math.isfinite(value) and value >= 0):
                raise InvalidSetup(f"{what} is {value!r} {unit}; valid is a finite number from 0.")
        super().__init__(name, limits_of(about))
        self.delay = delay
        """Time between a command and the motion that it causes [s]."""
        self._placement = RobotPlacement(name=_NAME, arm=about, gripper=gripper)
        self._noise, self._smoothing = noise, smoothing
        self._random = np.random.default_rng(seed)
        self._clock = clock
        self._world: TimedWorld | None = None
        self._lock = threading.RLock()  # a stop comes from any thread
        self._has_link = True
        self._is_frozen = False

    def freeze(self) -> None:
        """Stand still from now on: commands are taken and not obeyed, measurements go on, and no fault is told."""
        with self._lock:
            self._reach().stop(_NAME)
            self._is_frozen = True

    def thaw(self) -> None:
        """Obey again what is commanded from now on."""
        self._is_frozen = False

    def lose_link(self) -> None:
        """Have every later call fail, also `hold`, as when the cable is out; the arm stops by itself."""
        with self._lock:
            if self._world is not None:
                self._now(self._world).stop(_NAME)
            self._has_link = False

    def restore(self) -> None:
        """Put the cable back in; a fault stays until `recover`."""
        self._has_link = True

    def _open(self) -> None:
        self._require_link()
        if self._world is None:
            self._world = TimedWorld([self._placement], smoothing=self._smoothing)
        self._world.start(self._clock())

    def _state(self) -> ArmState:
        with self._lock:
            world = self._reach()
            robot = world.arms[_NAME]
            joints = robot.joints + self._random.normal(0.0, self._noise, self.dof) if self._noise else robot.joints
            return ArmState(
                list(joints),
                list(robot.velocities),
                time=world.time,
                device_time=world.time,
                commanded_joints=list(world.goal(_NAME)),
                mode="frozen" if self._is_frozen else "position",
            )

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        with self._lock:
            world = self._reach()
            if not self._is_frozen:
                world.command(_NAME, joints, at=self._clock() + self.delay)

    def _has_arrived(self) -> bool:
        with self._lock:
            world = self._reach()
            robot = world.arms[_NAME]
            is_there = np.abs(world.goal(_NAME) - robot.joints).max() < ARRIVED
            return bool(is_there and np.abs(robot.velocities).max() < STILL)

    def _hold(self) -> None:
        with self._lock:
            self._reach().stop(_NAME)

    def _recover(self) -> None:
        self._reach()

    def _reach(self) -> TimedWorld:
        """Return the world as it is now, unless the link is lost."""
        self._require_link()
        assert self._world is not None, "a call before `open` is refused by the interface"
        return self._now(self._world)

    def _require_link(self) -> None:
        if not self._has_link:
            raise DeviceFault("the link is lost")

    def _now(self, world: TimedWorld) -> TimedWorld:
        world.advance_to(self._clock())
        return world
