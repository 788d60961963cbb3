"""Leader arms for tests: their servos, in a process of their own, and calibrations."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import pi, tau
from pathlib import Path
from typing import Any

from rcs.teleop.gello import gello
from rcs.teleop.leader import Leader, LeaderCalibration
from rcs.teleop.so101_leader import so101_leader

STEP = tau / 4096
COUNTS = {"feetech": 6, "dynamixel": 8}
"""Servos of a leader."""


class Bus:
    """The servos' process."""

    def __init__(self, kind: str, count: int) -> None:
        program = [sys.executable, str(Path(__file__).parent / "leader_bus.py"), kind, str(count)]
        self._process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self.path = self._process.stdout.readline().strip()

    def tell(self, **given: Any) -> dict[str, dict[str, Any]]:
        """Tell it something; return torque, goals, limits and positions by servo."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(given) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def put(self, *positions: int) -> None:
        self.tell(positions=dict(enumerate(positions, 1)))

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def bus_of(kind: str, count: int) -> Iterator[Bus]:
    bus = Bus(kind, count)
    try:
        yield bus
    finally:
        bus.close()


def calibrated(port: str, **changes: Any) -> LeaderCalibration:
    values: dict[str, Any] = {"signs": (1, -1, 1, 1, 1, 1, 1), "offsets": (0.0, 1.0) + (0.0,) * 5, "near": (0.0,) * 7}
    values |= {"closed": pi, "opened": pi - 0.8, "servos": (1, 2, 3, 4, 5, 6, 7, 8)}
    return LeaderCalibration(address=port, **{**values, **changes})


def saved(calibration: LeaderCalibration, folder: Path) -> str:
    calibration.write(folder / "leader.json")
    return str(folder / "leader.json")


def leader_at(bus: Bus, kind: str, folder: Path, *, torque: bool = False) -> Leader:
    if kind == "feetech":
        return so101_leader(bus.path, torque=torque)
    return gello(saved(calibrated(bus.path), folder), torque=torque)
