"""Devices without hardware and without physics, for tests and for writing a program before the robot arrives.

All take a `clock`, which returns the time [s]: give the clock of a simulation to run faster than real time.
Measurements have its time as that of the device. `lose_link`, `restore` and `trip` are what happens to real devices.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import (
    Arm,
    ArmLimits,
    ArmState,
    Camera,
    CameraCalibration,
    CameraMode,
    Frame,
    Gripper,
    GripperState,
    Hand,
    HandState,
)
from rcs.errors import DeviceFault

Clock = Callable[[], float]


class Body:
    """What is behind a fake: values that run to their targets at constant speeds, and what has happened to it."""

    def __init__(self, clock: Clock, start: ArrayLike = (), speed: ArrayLike = ()) -> None:
        self._clock = clock
        self._lock = threading.Lock()  # a stop comes from any thread
        self._speed = np.asarray(speed, np.float64)
        self.values = np.array(start, np.float64)
        self.target = self.values.copy()
        self.velocities = np.zeros_like(self.values)
        self.time = clock()
        self.has_link = True
        self.has_reflex = False

    def move(self, *, stops: bool = False) -> None:
        """Let the time pass that has passed on the clock, and stay there if it stops."""
        now = self._clock()
        with self._lock:
            passed = max(now - self.time, 0.0)
            self.time = max(now, self.time)
            step = np.clip(self.target - self.values, -self._speed * passed, self._speed * passed)
            self.values = self.values + step
            self.velocities = step / passed if passed > 0 else np.zeros_like(step)
            if stops:
                self.target = self.values.copy()

    def stop(self) -> None:
        """Stay here."""
        self.move(stops=True)


def _reach(device: Fake) -> Body:
    """Return what is behind a device as it is now, unless its link is lost."""
    body = device.body
    if not body.has_link:
        device.set_fault("the link is lost")
        raise DeviceFault(f"{device.name}: the link is lost")
    body.move()
    return body


def _lose_link(device: Fake) -> None:
    """Have every later call fail, as when the cable is out; the device stops by itself."""
    device.body.stop()
    device.body.has_link = False


def _restore(device: Fake) -> None:
    """Put the cable back in; a fault stays until `recover`."""
    device.body.has_link = True


def _trip(device: Fake, reason: str) -> None:
    """Stop and go into fault as a controller does in a reflex: it refuses even `hold` until `recover`."""
    device.body.stop()
    device.body.has_reflex = True
    device.set_fault(reason)


def _hold(device: Fake) -> None:
    if device.body.has_reflex:
        raise DeviceFault(f"{device.name}: hold is refused in a reflex; call recover() first")
    device.body.stop()


def _recover(device: Fake) -> None:
    _reach(device).has_reflex = False


def _has_arrived(device: Fake) -> bool:
    body = _reach(device)
    return bool(np.abs(body.target - body.values).max() < 1e-9)


class FakeArm(Arm):
    """An arm that moves to its target at its largest joint velocities; `push` is a person's hand."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _hold, _recover, _has_arrived = _hold, _recover, _has_arrived

    def __init__(
        self,
        limits: ArmLimits,
        *,
        start: NDArray[np.float64] | None = None,
        clock: Clock = time.monotonic,
        name: str = "fake arm",
    ) -> None:
        """Stand at `start`.

        Args:
            limits: Joint limits and velocities.
            start: Joints at the beginning [rad], shape (dof,); the middle of the limits when not given.
            clock: Returns the time [s].
            name: Name in messages.
        """
        super().__init__(name, limits)
        middle = (limits.joint_lower + limits.joint_upper) / 2
        self.body = Body(clock, middle if start is None else start, limits.joint_velocity)

    def push(self, joints: NDArray[np.float64]) -> None:
        """Move the arm by a difference of joints [rad] as a person would who guides it: its target goes with it."""
        self.body.move()
        self.body.values = np.clip(self.body.values + joints, self.limits.joint_lower, self.limits.joint_upper)
        self.body.target = self.body.values.copy()

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        _reach(self).stop()

    def _state(self) -> ArmState:
        body = _reach(self)
        return ArmState(
            list(body.values),
            list(body.velocities),
            device_time=body.time,
            commanded_joints=list(body.target),
            efforts=[0.0] * self.dof,
            mode="guided" if self.is_guided else "position",
        )

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        _reach(self).target = np.array(joints)


class FakeGripper(Gripper):
    """A gripper that opens and closes at a constant speed."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _hold, _recover, _has_arrived = _hold, _recover, _has_arrived

    def __init__(
        self,
        *,
        max_width: float = 0.08,
        max_force: float = 70.0,
        speed: float = 2.5,
        clock: Clock = time.monotonic,
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
        self.body = Body(clock, [1.0], [speed])

    def _state(self) -> GripperState:
        body = _reach(self)
        return GripperState(float(body.values[0]), device_time=body.time)

    def _command_opening(self, opening: float, force: float | None) -> None:
        _reach(self).target = np.clip([opening], 0.0, 1.0)


class FakeHand(Hand):
    """A hand whose joints move at a constant speed."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _hold, _recover, _has_arrived = _hold, _recover, _has_arrived

    def __init__(
        self, joint_count: int, *, speed: float = 2.5, clock: Clock = time.monotonic, name: str = "fake hand"
    ) -> None:
        """Stand open, all joints at 0; `speed` is the change of every joint per second, as a share of its range."""
        super().__init__(name, joint_count)
        self.body = Body(clock, np.zeros(joint_count), speed)

    def _state(self) -> HandState:
        body = _reach(self)
        return HandState(list(body.values), device_time=body.time)

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        _reach(self).target = np.clip(joints, 0.0, 1.0)


class FakeCamera(Camera):
    """A camera that sees a grey ramp which moves one pixel per frame, so that repeats can be told from new frames."""

    lose_link, _recover = _lose_link, _recover

    def __init__(
        self,
        mode: CameraMode,
        *,
        calibration: CameraCalibration | None = None,
        clock: Clock = time.monotonic,
        name: str = "fake camera",
    ) -> None:
        """Deliver frames of `mode`, a new one every `1 / fps` seconds of `clock`."""
        super().__init__(name, mode)
        self.body = Body(clock)
        self._known_calibration = calibration
        self._frozen: Frame | None = None

    def freeze(self) -> None:
        """Give the newest frame again and again from now on, as a camera does that hangs."""
        self._frozen = self.read()

    def restore(self) -> None:
        """Put the cable back in, and go on with new frames."""
        _restore(self)
        self._frozen = None

    def _calibration(self) -> CameraCalibration | None:
        return self._known_calibration

    def _read(self) -> Frame:
        number = int(_reach(self).time * self.mode.fps)
        if self._frozen is not None:
            return self._frozen
        ramp = ((np.arange(self.mode.width) + number) % 256).astype(np.uint8)
        rgb = np.broadcast_to(ramp[None, :, None], (self.mode.height, self.mode.width, 3))
        depth = np.full((self.mode.height, self.mode.width), 1000, np.uint16) if self.mode.has_depth else None
        return Frame(np.ascontiguousarray(rgb), depth, number=number, device_time=number / self.mode.fps)


Fake = FakeArm | FakeGripper | FakeHand | FakeCamera
