"""Devices without hardware and without physics, for tests and for writing a program before the robot arrives.

All take a `clock`, which returns the time [s] and is the device time of measurements: pass the clock of a simulation to
run faster than real time. `lose_link`, `restore` and `trip` imitate the faults of real devices: without a link every
call fails, even `hold`. The first command switches the power on; closing the device switches it off.
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
    """State of a fake: values that move to their targets at constant speeds, and its faults."""

    def __init__(self, clock: Clock, start: ArrayLike = (), speed: ArrayLike = ()) -> None:
        self._clock = clock
        self._lock = threading.Lock()  # a stop may come from any thread
        self._speed = np.asarray(speed, np.float64)
        self.values = np.array(start, np.float64)
        self.target = self.values.copy()
        self.velocities = np.zeros_like(self.values)
        self.time = clock()
        self.has_link = True
        self.has_reflex = False
        self.has_power = False

    def move(self, *, stops: bool = False) -> None:
        """Move up to the present time of the clock; with `stops`, stay there."""
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
        """Stop at the present values."""
        self.move(stops=True)


def _reach(device: Fake) -> Body:
    """Return the state of a device at the present time, unless its link is lost."""
    body = device.body
    if not body.has_link:
        raise DeviceFault("the link is lost")
    body.move()
    return body


def _command(device: Fake, target: NDArray[np.float64]) -> None:
    body = _reach(device)
    body.has_power = True
    body.target = target


def _open(device: Fake) -> None:
    _reach(device)


def _lose_link(device: Fake) -> None:
    """Make every later call fail, even `hold`, as if the cable were unplugged; the device stops by itself."""
    device.body.stop()
    device.body.has_link = False


def _restore(device: Fake) -> None:
    """Restore the link; a fault remains until `recover`."""
    device.body.has_link = True


def _trip(device: Fake, reason: str) -> None:
    """Stop and enter the fault state, like a controller in a reflex, which refuses even `hold` until `recover`."""
    device.body.stop()
    device.body.has_reflex = True
    device.set_fault(reason)


def _hold(device: Fake) -> None:
    if device.body.has_reflex:
        raise DeviceFault("hold is refused in a reflex; call recover() first")
    _reach(device).stop()


def _recover(device: Fake) -> None:
    _reach(device).has_reflex = False


def _has_arrived(device: Fake) -> bool:
    body = _reach(device)
    return bool(np.abs(body.target - body.values).max() < 1e-9)


def _close(device: Fake) -> None:
    device.body.has_power = False


class FakeArm(Arm):
    """An arm that moves to its target at its largest joint velocities; `push` imitates a person's hand."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _open, _hold, _recover, _has_arrived, _close = _open, _hold, _recover, _has_arrived, _close

    def __init__(
        self,
        limits: ArmLimits,
        *,
        start: NDArray[np.float64] | None = None,
        clock: Clock = time.monotonic,
        name: str = "fake arm",
    ) -> None:
        """Start at rest at `start`.

        Args:
            limits: Joint limits and velocities.
            start: Initial joint positions [rad], shape (dof,); None for the middle of the limits.
            clock: Returns the time [s].
            name: Name of the device in messages.
        """
        super().__init__(name, limits)
        middle = (limits.joint_lower + limits.joint_upper) / 2
        self.body = Body(clock, middle if start is None else start, limits.joint_velocity)

    def push(self, joints: NDArray[np.float64]) -> None:
        """Move the arm and its target by a difference of joint positions [rad], like a person who guides it."""
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
        _command(self, np.array(joints))


class FakeGripper(Gripper):
    """A gripper that opens and closes at a constant speed."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _open, _hold, _recover, _has_arrived, _close = _open, _hold, _recover, _has_arrived, _close

    def __init__(
        self,
        *,
        max_width: float = 0.08,
        max_force: float = 70.0,
        speed: float = 2.5,
        clock: Clock = time.monotonic,
        name: str = "fake gripper",
    ) -> None:
        """Start open.

        Args:
            max_width: Width at opening 1 [m].
            max_force: Largest force [N].
            speed: Change of the opening per second [1/s].
            clock: Returns the time [s].
            name: Name of the device in messages.
        """
        super().__init__(name, max_width, max_force)
        self.body = Body(clock, [1.0], [speed])

    def _state(self) -> GripperState:
        body = _reach(self)
        return GripperState(float(body.values[0]), device_time=body.time)

    def _command_opening(self, opening: float, force: float | None) -> None:
        _command(self, np.clip([opening], 0.0, 1.0))


class FakeHand(Hand):
    """A hand whose joints move at a constant speed."""

    lose_link, restore, trip = _lose_link, _restore, _trip
    _open, _hold, _recover, _has_arrived, _close = _open, _hold, _recover, _has_arrived, _close

    def __init__(
        self, joint_count: int, *, speed: float = 2.5, clock: Clock = time.monotonic, name: str = "fake hand"
    ) -> None:
        """Start open, all joints at 0; `speed` is the change of every joint per second, as a fraction of its range."""
        super().__init__(name, joint_count)
        self.body = Body(clock, np.zeros(joint_count), speed)

    def _state(self) -> HandState:
        body = _reach(self)
        return HandState(list(body.values), device_time=body.time)

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        _command(self, np.clip(joints, 0.0, 1.0))


class FakeCamera(Camera):
    """A camera that shows a grey ramp, which moves one pixel per frame to distinguish new frames from repeated ones."""

    lose_link, _open, _recover = _lose_link, _open, _recover

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
        """Return the same frame from now on, like a camera that hangs."""
        self._frozen = self.read()

    def restore(self) -> None:
        """Restore the link and return new frames."""
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
