"""A streamed arm whose controller is a servo in this process."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from rcs.devices import ArmLimits, ArmState, StreamedArm, StreamOptions, StreamPoint

LIMITS = ArmLimits([-2.0, -1.5, -3.0], [2.0, 1.0, 0.5], [2.0, 1.5, 3.0], [10.0, 8.0, 12.0], [500.0, 1000.0, 5000.0])
START = np.array([0.1, -0.2, -0.5])
PERIOD, TICKS = 0.04, 10  # 250 Hz


class Servo(StreamedArm):
    """Joints that are where the points say."""

    def __init__(self, limits: ArmLimits = LIMITS, start: Any = START, **options: Any) -> None:
        options = {"rate": 250.0, "period": PERIOD, "missed_ticks": 1000, "silence": 5.0, **options}
        super().__init__("servo", limits, StreamOptions(**options))
        self.joints, self.velocities = np.array(start), np.zeros(len(start))
        self.points: list[StreamPoint] = []
        self.calls: list[str] = []
        self.error: Exception | None = None
        self.has_reflex = False
        self._go, self._idle = threading.Semaphore(0), threading.Semaphore(0)
        self.is_free = not options.get("is_paced_by_read", False)

    def advance(self, ticks: int) -> None:
        """Let so many ticks pass; the thread then waits for the next."""
        for _ in range(ticks):
            self._go.release()
            self._idle.acquire()

    def _open(self) -> None:
        self.calls.append("open")

    def _start(self) -> None:
        self.calls.append("start")

    def _read(self) -> ArmState:
        if not self.is_free and threading.current_thread() is not threading.main_thread() and self.calls[-1] != "start":
            self._idle.release()
            self._go.acquire()
        if self.calls[-1] == "start":
            self.calls.append("read")
        if self.error is not None:
            raise self.error
        return ArmState(self.joints, self.velocities)

    def _write(self, point: StreamPoint) -> None:
        if self.has_reflex:
            raise RuntimeError("reflex")
        self.points.append(point)
        self.joints, self.velocities = point.position, point.velocity

    def _stop(self) -> None:
        self.calls.append("stop")

    def _clear(self) -> None:
        self.calls.append("clear")
        self.has_reflex = False

    def _close(self) -> None:
        self.calls.append("close")

    def open_and_wait(self) -> Servo:
        """Open it, and return when its thread waits for the first tick."""
        self.open()
        self._idle.acquire()
        return self

    def run_freely(self) -> None:
        self.is_free = True
        self._go.release()


def await_fault(device: StreamedArm) -> None:
    for _ in range(3000):
        if device.fault:
            return
        time.sleep(0.001)
    pytest.fail("no fault came")
