"""A simulated arm behind the interface of real ones, with delay and noise."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Natural, NotNegative, Positive, Record

from rcs.devices import Arm, ArmState
from rcs.errors import DeviceFault
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.sim.scene import RobotPlacement
from rcs.sim.timed_world import SMOOTHING, TimedWorld

ARRIVED = 2e-3
"""Distance to the target below which a joint has arrived [rad]."""
STILL = 5e-3
"""Speed below which a joint stands still [rad/s]."""

_NAME = "arm"


class StandInOptions(Record):
    """A site's options for a stand-in."""

    delay: NotNegative = 0.02
    """Delay between a command and the resulting motion [s]."""
    noise: NotNegative = 0.0
    """Standard deviation of every measured joint [rad]."""
    seed: Natural = 0
    """Random seed of the noise."""
    smoothing: Positive = SMOOTHING
    """Time constant of each of the two low-passes that smooth targets [s]."""
    gripper: str | None = None
    """Name of the gripper that it carries, for its mass; None for none."""


class StandInArm(Arm):
    """A simulated arm that follows commands with a delay and measures its joints with noise.

    Each call first simulates up to the present time of its clock, so the arm moves in real time without a thread.
    `freeze` stops it silently, like a controller that hangs; `lose_link` and `restore` work as in the fakes.
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
        """Create the arm; the simulation starts at the home position in `open`.

        Args:
            about: Description of the arm.
            gripper: Gripper that it carries, for its mass; None for none.
            delay: Delay between a command and the resulting motion [s].
            noise: Standard deviation of every measured joint [rad].
            seed: Random seed of the noise.
            smoothing: Time constant of each of the two low-passes that smooth targets [s].
            clock: Returns the time [s].
            name: Name of the arm in messages.

        Raises:
            InvalidSetup: A number is invalid; see `StandInOptions`.
        """
        StandInOptions(delay=delay, noise=noise, seed=seed, smoothing=smoothing)
        super().__init__(name, about.arm_limits)
        self.delay = delay
        """Delay between a command and the resulting motion [s]."""
        self._placement = RobotPlacement(name=_NAME, arm=about, gripper=gripper)
        self._noise, self._smoothing = noise, smoothing
        self._random = np.random.default_rng(seed)
        self._clock = clock
        self._world: TimedWorld | None = None
        self._lock = threading.RLock()  # a stop may come from any thread
        self._has_link = True
        self._is_frozen = False

    def freeze(self) -> None:
        """Stand still from now on: commands are accepted but ignored, measurements continue, and there is no fault."""
        with self._lock:
            self._reach().stop(_NAME)
            self._is_frozen = True

    def thaw(self) -> None:
        """Follow commands again from now on."""
        self._is_frozen = False

    def lose_link(self) -> None:
        """Make every later call fail, even `hold`, as if the cable were unplugged; the arm stops by itself."""
        with self._lock:
            if self._world is not None:
                self._now(self._world).stop(_NAME)
            self._has_link = False

    def restore(self) -> None:
        """Restore the link; a fault remains until `recover`."""
        self._has_link = True

    def _open(self) -> None:
        self._require_link()
        if self._world is None:
            self._world = TimedWorld([self._placement], smoothing=self._smoothing)
        self._world.start(self._clock())

    def _state(self) -> ArmState:
        with self._lock:
            world = self._reach()
            robot = world.arms[_NAME].robot
            joints = robot.joints + self._random.normal(0.0, self._noise, self.dof) if self._noise else robot.joints
            return ArmState(
                list(joints),
                list(robot.joint_velocities),
                time=min(world.time, self._clock()),  # the world is ahead by part of a physics step
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
            robot = world.arms[_NAME].robot
            is_there = np.abs(world.goal(_NAME) - robot.joints).max() < ARRIVED
            return bool(is_there and np.abs(robot.joint_velocities).max() < STILL)

    def _hold(self) -> None:
        with self._lock:
            self._reach().stop(_NAME)

    def _recover(self) -> None:
        self._reach()

    def _reach(self) -> TimedWorld:
        """Return the world at the present time, unless the link is lost."""
        self._require_link()
        assert self._world is not None, "a call before `open` is refused by the interface"
        return self._now(self._world)

    def _require_link(self) -> None:
        if not self._has_link:
            raise DeviceFault("the link is lost")

    def _now(self, world: TimedWorld) -> TimedWorld:
        world.advance_to(self._clock())
        return world
