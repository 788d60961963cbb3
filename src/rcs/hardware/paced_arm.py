"""An arm whose controller takes a point every few milliseconds, led by a thread of its own."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from rcs._core import MotionLimits, Trajectory
from rcs.devices import Arm, ArmLimits, ArmState
from rcs.errors import DeviceFault, InvalidAction

FIRST_STEP = 0.2
"""How far from the measured joints the first target may be [rad]."""
TRACKING_ERROR = 0.3
"""How far from where it is led a joint may be measured [rad]."""
ARRIVED = 0.01
"""A joint within this of its target has arrived [rad]."""


class PacedArm(Arm):
    """Subclasses override `_read`, `_start`, `_write`, `_stop` and `_clear`, which run one at a time."""

    def __init__(self, name: str, limits: ArmLimits, *, rate: float, period: float = 1.0 / 30.0) -> None:
        """Describe the arm.

        Args:
            name: Name in messages.
            limits: Its limits, those of acceleration and jerk too.
            rate: Points per second [Hz].
            period: Time between commands [s].
        """
        super().__init__(name, limits)
        self._law = Trajectory(
            MotionLimits(
                list(limits.joint_lower),
                list(limits.joint_upper),
                list(limits.joint_velocity),
                list(limits.joint_acceleration),
                list(limits.joint_jerk),
            )
        )
        self._memory = np.zeros(Trajectory.size(self.dof))
        self._tick, self.period = 1.0 / rate, period
        self._lock = threading.RLock()
        self._thread: threading.Thread | None = None
        self._is_ending = self._is_led = False
        self._newest: ArmState | None = None

    @abstractmethod
    def _read(self) -> ArmState:
        """Measure."""

    def _start(self) -> None:
        """Switch on what follows points: the next one is where the arm is."""

    @abstractmethod
    def _write(self, point: NDArray[np.float64]) -> None:
        """Send the point of this tick [rad], (dof,)."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop at once, and hold."""

    def _clear(self) -> None:
        """Leave the controller's fault state. Nothing moves."""

    def _open(self) -> None:
        self._newest = self._read()
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name=f"{self.name} points", daemon=True)
        self._thread.start()

    def _close(self) -> None:
        self._is_ending = True
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _guide(self) -> None:
        self._is_led = False

    def _state(self) -> ArmState:
        newest = self._newest
        assert newest is not None, "it is open"
        return newest

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        with self._lock:
            if not self._is_led:
                self._begin(joints)
            self._memory[: self.dof] = joints
            self._law.follow(self._memory, self.period)

    def _begin(self, joints: NDArray[np.float64]) -> None:
        here = np.array(self._read().joints)
        ways = np.abs(joints - here)
        if ways.max() > FIRST_STEP:
            far = int(ways.argmax())
            raise InvalidAction(
                f"{self.name}: the first target is {ways[far]:.2f} rad from where joint {far} is measured; valid is up "
                f"to {FIRST_STEP} rad."
            )
        self._start()
        self._stand(np.clip(here, self.limits.joint_lower, self.limits.joint_upper))
        self._is_led = True

    def _stand(self, joints: NDArray[np.float64]) -> None:
        self._memory[:] = 0.0
        for row in Trajectory.POSITION_ROWS:
            self._memory[row * self.dof : (row + 1) * self.dof] = joints

    def _has_arrived(self) -> bool:
        state = self._state()
        is_there = np.abs(np.array(state.joints) - self._memory[: self.dof]).max() < ARRIVED
        return not self._is_led or bool(is_there and np.abs(state.joint_velocities).max() < ARRIVED)

    def _hold(self) -> None:
        with self._lock:
            if not self._is_led:
                self._stop()
            elif self.fault:
                self._is_led = False
                self._stop()
            else:
                self._law.brake(self._memory)

    def _recover(self) -> None:
        with self._lock:
            self._clear()
            self._newest = self._read()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._is_ending:
            due += self._tick
            time.sleep(max(due - time.monotonic(), 0.0))
            due = max(due, time.monotonic() - self._tick)
            if self.fault:
                continue
            try:
                with self._lock:
                    self._newest = self._read()
                    if self._is_led:
                        self._lead()
            except Exception as err:  # noqa: BLE001 - whatever a vendor's library raises is the arm's fault
                self.set_fault(str(err))

    def _lead(self) -> None:
        self._law.advance(self._memory, self._tick)
        position = self._law.state(self._memory)[0]
        assert self._newest is not None, "it has just been read"
        off = np.abs(position - np.array(self._newest.joints))
        if off.max() > TRACKING_ERROR:
            raise DeviceFault(f"joint {int(off.argmax())} is {off.max():.2f} rad from where it is led: it is blocked")
        self._write(position)
