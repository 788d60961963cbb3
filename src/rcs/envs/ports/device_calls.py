"""The calls of a gripper or a hand, and the ages of what devices measure.

Calls are made at once while they are quick, on a thread of their own once they are not. An answer that a library
repeats after the cable is out must not look new.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState, Gripper, GripperState, Hand, HandState
from rcs.errors import DeviceFault

_log = logging.getLogger(__name__)

SLOW_READS = 2
"""After this many slow reads in a row, a device is slow; one alone may be the machine's."""
PAUSE = 5e-3
"""Time between two calls of a slow device [s], for others on its line."""
PAUSE_IN_FAULT = 0.1
"""The same after a call that failed [s]."""
CYCLES = 3.0
"""A command of a slow device is valid for at least as many of its cycles: it cannot be repeated sooner."""
LONGEST_CALL = 2.0
"""How long closing or recovering a device waits for a call that is under way [s]."""
STARTING = "starting"
"""Mode of a streamed arm that is being switched on, and measures nothing meanwhile."""
START_TIME = 10.0
"""How long an arm may take for that [s]."""


class DeviceCalls:
    """Sends commands to one device and reads it; neither holds up the caller, however slow the device is.

    From its second slow read on, a device is commanded and read on a thread, one call at a time: it gets the newest
    command as soon as it is free, and the caller its newest state. Any error of a call there is the device's fault.
    """

    def __init__(self, device: Gripper | Hand, *, valid_for: float = math.inf, slow_after: float = math.inf) -> None:
        """Call nothing yet.

        Args:
            device: The device.
            valid_for: How long a command is valid without another [s].
            slow_after: A read that takes longer than this is slow [s].
        """
        self._device = device
        self._valid_for = valid_for
        self._slow_after = slow_after
        self._slow_reads = 0
        self._waiting: deque[tuple[NDArray[np.float32], int]] = deque(maxlen=1)  # whose calls are atomic
        self._holds = 0
        self._newest: GripperState | HandState | None = None
        self._cycle = 0.0
        self._turn = threading.Lock()
        self._must_end = threading.Event()
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None

    def open(self) -> None:
        """Connect the device.

        Raises:
            DeviceFault: A call has not returned since it was last closed.
        """
        if self._must_end.is_set():
            if self._thread is not None and self._thread.is_alive():
                raise DeviceFault(
                    f"{self._device.name} is still in a call that was under way when it was closed; unplug the device "
                    "or end the process."
                )
            self._thread, self._slow_reads = None, 0
            self._must_end.clear()
        self._device.open()

    def send(self, target: NDArray[np.float32]) -> None:
        """Send a target, or have it sent as soon as a slow device is free."""
        if self._thread is None:
            self._send(target, self._valid_for)
        else:
            self._waiting.append((target, self._holds))

    def read(self) -> GripperState | HandState:
        """Measure the device, or return what a slow one has measured last."""
        if self._thread is not None:
            assert self._newest is not None, "the thread begins with a state"
            return self._newest
        begin = time.monotonic()
        state = self._newest = self._device.state()
        self._cycle = time.monotonic() - begin
        self._slow_reads = self._slow_reads + 1 if self._cycle > self._slow_after else 0
        if self._slow_reads == SLOW_READS:
            _log.info("%s takes %.0f ms to read: from now on on a thread", self._device.name, 1e3 * self._cycle)
            self._thread = threading.Thread(target=self._run, name=self._device.name, daemon=True)
            self._thread.start()
        return state

    def forget(self) -> None:
        """Drop a command that waits; the caller holds the device."""
        self._holds += 1
        self._waiting.clear()

    def recover(self) -> None:
        """Clear the device's fault, and measure it.

        Raises:
            DeviceFault: The device cannot recover, or does not return from a call.
        """
        if not self._turn.acquire(timeout=LONGEST_CALL):
            raise DeviceFault(f"{self._device.name} has not returned from a call for {LONGEST_CALL:g} s.")
        try:
            self._device.recover()
            self._newest = self._device.state()
        finally:
            self._turn.release()

    def close(self) -> None:
        """Let go of the device. Closing twice is harmless.

        A device that does not return from a call is left to its thread, with a warning, and closed when it does.
        """
        is_first = not self._must_end.is_set()
        self._must_end.set()
        if self._thread is None:
            self._device.close()
            return
        if is_first:
            self._thread.join(LONGEST_CALL)
        if is_first and self._thread.is_alive():
            _log.warning(
                "%s has not returned from a call for %g s; its thread is left behind, and closes it when the call "
                "returns",
                self._device.name,
                LONGEST_CALL,
            )
        if (error := self._error) is not None:
            self._error = None
            raise error

    def _run(self) -> None:
        pause = PAUSE
        while not self._must_end.wait(pause):
            pause, begin = PAUSE, time.monotonic()
            with self._turn:
                try:
                    self._send_waiting()
                    self._newest = self._device.state()
                except Exception as err:  # noqa: BLE001  whatever it is, it is the device's fault
                    pause = PAUSE_IN_FAULT
                    if not self._device.fault:
                        self._device.set_fault(f"{type(err).__name__}: {err}")
            self._cycle = time.monotonic() - begin
        try:
            self._device.close()
        except Exception as err:  # noqa: BLE001  raised by `close`, which waits
            self._error = err

    def _send_waiting(self) -> None:
        if not self._waiting or self._device.fault:
            return
        try:
            target, holds = self._waiting.pop()
        except IndexError:  # forgotten meanwhile
            return
        self._send(target, max(self._valid_for, CYCLES * (self._cycle + PAUSE)))
        if self._holds != holds:
            self._device.hold()  # `hold` was called while this command was on its way

    def _send(self, target: NDArray[np.float32], valid_for: float) -> None:
        if isinstance(self._device, Gripper):
            self._device.command_opening(float(target[0]), valid_for=valid_for)
        else:
            self._device.command_joints(target.astype(np.float64), valid_for)


LEAD = 0.1
"""An arm without a clock whose target has moved by this [rad], while not one number changed, repeats its last answer.

An arm that stands still may well measure the same again and again: encoders count in steps.
"""


class Freshness:
    """Knows when a device last measured something new, and sets its fault when that is too long ago.

    A repeat shows in the device's own clock, `device_time`, which stands still, or in the age that its driver gives,
    `time`. An arm that has neither is known to repeat when its target moves and nothing else does.
    """

    def __init__(self, device: Arm | Gripper | Hand, stale_after: float = math.inf) -> None:
        """Watch a device.

        Args:
            device: The device.
            stale_after: Age of what it measures from which it is in its fault state [s].
        """
        self.time = 0.0
        """When what was measured last was new [s, monotonic clock of the host]."""
        self.device_time = math.nan
        """The same on the device's own clock [s]; NaN without one."""
        self._device = device
        self._stale_after = stale_after
        self._mark: float | bytes | None = None
        self._target: NDArray[np.float64] | None = None
        self._was_led = False

    def judge(self, state: ArmState | GripperState | HandState, target: NDArray[np.float64] | None = None) -> None:
        """Look at what was measured; the device is in its fault state after it if that is too old.

        Args:
            state: Measurement of the device.
            target: Last target of an arm [rad], shape (dof,); None before the first.
        """
        has_clock = math.isfinite(state.device_time)
        self.device_time = state.device_time
        mark = state.device_time if has_clock else _numbers(state)
        if mark is None or mark != self._mark:
            self._mark, self._target, self.time, self._was_led = mark, target, state.time, False
        elif not has_clock and not self._was_led:  # the age counts from here
            self.time, self._was_led = state.time, self._is_led(target)
        age = time.monotonic() - self.time
        is_starting = isinstance(state, ArmState) and state.mode == STARTING
        patience = max(START_TIME, self._stale_after) if is_starting else self._stale_after
        if age > patience and not self._device.fault:
            self._device.set_fault(
                f"nothing new measured for {age:.2f} s, more than {patience:g} s; look at the cable and at "
                "the controller"
            )

    def _is_led(self, target: NDArray[np.float64] | None) -> bool:
        """Return whether the target has moved away since a number changed."""
        if target is None or self._target is None:
            self._target = target
            return False
        return bool(np.abs(target - self._target).max() > LEAD)


def _numbers(state: ArmState | GripperState | HandState) -> bytes | None:
    """Return all that an arm without a clock measures; None of a gripper or hand, which stand still on an object."""
    if not isinstance(state, ArmState):
        return None
    measured = (state.joints, state.joint_velocities, state.efforts, state.wrench)
    return b"".join(np.asarray(one).tobytes() for one in measured)
