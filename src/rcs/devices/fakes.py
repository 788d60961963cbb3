"""Devices without hardware and without physics, for tests and for writing a program before the robot arrives."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rcs._core import Arm, ArmLimits, ArmState, Camera, CameraMode, Frame, Gripper, GripperState, Hand, HandState
from rcs.errors import DeviceFault


class FakeArm(Arm):
    """An arm that moves to its target at its largest joint velocities, on a clock of the caller's choice."""

    def __init__(
        self,
        limits: ArmLimits,
        *,
        start: NDArray[np.float64] | None = None,
        clock: Callable[[], float] = time.monotonic,
        name: str = "fake arm",
    ) -> None:
        """Stand at `start`.

        Args:
            limits: Joint limits and velocities.
            start: Joints at the beginning [rad], shape (dof,); the middle of the limits when not given.
            clock: Returns the time [s]; give the clock of a simulation to run faster than real time.
            name: Name in messages.
        """
        super().__init__(name, limits)
        middle = (limits.joint_lower + limits.joint_upper) / 2
        self._clock = clock
        self._joints = np.array(middle if start is None else start, dtype=np.float64)
        self._velocities = np.zeros(self.dof)
        self._target = self._joints.copy()
        self._time = clock()
        self._has_link = True
        self._has_reflex = False

    def trip(self, reason: str) -> None:
        """Stop and go into fault as a controller does in a reflex: it refuses even `hold` until `recover`."""
        self._hold()
        self._has_reflex = True
        self.set_fault(reason)

    def _move(self) -> None:
        now = self._clock()
        passed = max(now - self._time, 0.0)
        self._time = now
        reach = self.limits.joint_velocity * passed
        step = np.clip(self._target - self._joints, -reach, reach)
        self._joints = self._joints + step
        self._velocities = step / passed if passed > 0 else np.zeros(self.dof)

    def push(self, joints: NDArray[np.float64]) -> None:
        """Move the arm by a difference of joints [rad] as a person would who guides it: its target goes with it."""
        self._move()
        self._joints = np.clip(self._joints + joints, self.limits.joint_lower, self.limits.joint_upper)
        self._target = self._joints.copy()

    def lose_link(self) -> None:
        """Fail to be measured from now on, as a device whose cable is out."""
        self._has_link = False

    def _open(self) -> None:
        self._time = self._clock()

    def _state(self) -> ArmState:
        if not self._has_link:
            raise DeviceFault(f"{self.name}: the link is lost")
        self._move()
        return ArmState(list(self._joints), list(self._velocities), self._time)

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        self._move()
        self._target = np.clip(joints, self.limits.joint_lower, self.limits.joint_upper)

    def _has_arrived(self) -> bool:
        self._move()
        return bool(np.abs(self._target - self._joints).max() < 1e-9)

    def _hold(self) -> None:
        if self._has_reflex:
            raise DeviceFault(f"{self.name}: hold is refused in a reflex; call recover() first")
        self._move()
        self._target = self._joints.copy()

    def _recover(self) -> None:
        self._has_reflex = False


class FakeGripper(Gripper):
    """A gripper that opens and closes at a constant speed."""

    def __init__(
        self,
        *,
        max_width: float = 0.08,
        max_force: float = 70.0,
        speed: float = 2.5,
        clock: Callable[[], float] = time.monotonic,
        name: str = "fake gripper",
    ) -> None:
        """Stand open.

        Args:
            max_width: Width at opening 1 [m].
            max_force: Largest force [N].
            speed: Change of the opening per second [1/s].
            clock: Returns the time [s].
            name: Name in messages.
        """
        super().__init__(name, max_width, max_force)
        self._clock = clock
        self._speed = speed
        self._opening = self._target = 1.0
        self._time = clock()

    def _move(self) -> None:
        now = self._clock()
        reach = self._speed * max(now - self._time, 0.0)
        self._time = now
        self._opening += float(np.clip(self._target - self._opening, -reach, reach))

    def _open(self) -> None:
        self._time = self._clock()

    def _state(self) -> GripperState:
        self._move()
        return GripperState(self._opening, 0.0, self._time)

    def _command_opening(self, opening: float) -> None:
        self._move()
        self._target = min(max(opening, 0.0), 1.0)

    def _has_arrived(self) -> bool:
        self._move()
        return abs(self._target - self._opening) < 1e-9

    def _hold(self) -> None:
        self._move()
        self._target = self._opening


class FakeHand(Hand):
    """A hand whose joints are at their targets at once."""

    def __init__(
        self, joint_count: int, *, clock: Callable[[], float] = time.monotonic, name: str = "fake hand"
    ) -> None:
        """Stand open, all joints at 0."""
        super().__init__(name, joint_count)
        self._clock = clock
        self._joints = np.zeros(joint_count)

    def _state(self) -> HandState:
        return HandState(list(self._joints), self._clock())

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        self._joints = np.clip(joints, 0.0, 1.0)

    def _has_arrived(self) -> bool:
        return True

    def _hold(self) -> None:
        return


class FakeCamera(Camera):
    """A camera that sees a grey ramp which moves one pixel per frame, so that repeats can be told from new frames."""

    def __init__(
        self, mode: CameraMode, *, clock: Callable[[], float] = time.monotonic, name: str = "fake camera"
    ) -> None:
        """Deliver frames of `mode`, a new one every `1 / fps` seconds of `clock`."""
        super().__init__(name, mode)
        self._clock = clock

    def _read(self) -> Frame:
        number = int(self._clock() * self.mode.fps)
        ramp = ((np.arange(self.mode.width) + number) % 256).astype(np.uint8)
        rgb = np.broadcast_to(ramp[None, :, None], (self.mode.height, self.mode.width, 3))
        depth = np.full((self.mode.height, self.mode.width), 1000, np.uint16) if self.mode.has_depth else None
        return Frame(np.ascontiguousarray(rgb), depth, number / self.mode.fps, number)
