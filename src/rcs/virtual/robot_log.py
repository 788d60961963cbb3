"""The log of a virtual robot: events as JSON lines; ticks and the clients' setpoints in binary files next to them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

FLUSH = 0.25
"""Longest time for which log entries stay in memory [s]."""
ROWS = 1024
"""Largest number of rows of a file that stay in memory."""


def tick_type(dof: int) -> np.dtype[np.void]:
    """Return the type of a tick of a robot with `dof` joints, in SI units, with times on the monotonic clock [s].

    `due` is the planned and `time` the actual start of the tick; `commanded` is the servos' reference [rad], NaN while
    torques are commanded; `joints`, `velocities` and `torques` are measured at the end of the tick; `width` is that of
    the gripper [m], NaN without one.
    """
    joints = [(name, np.float64, (dof,)) for name in ("commanded", "joints")]
    more = [(name, np.float32, (dof,)) for name in ("velocities", "torques")]
    return np.dtype([("due", np.float64), ("time", np.float64), *joints, *more, ("width", np.float32)])


def point_type(dof: int) -> np.dtype[np.void]:
    """Return the type of a setpoint from a client.

    `time` is when it was received, on the monotonic clock [s]; `joints` [rad] or `torques` [N·m] are NaN if they were
    not sent.
    """
    return np.dtype([("time", np.float64), *((name, np.float64, (dof,)) for name in ("joints", "torques"))])


def read_ticks(path: Path | str, robot: str = "") -> NDArray[np.void]:
    """Return the ticks of a log, a structured array of `tick_type`.

    Args:
        path: Path of the log.
        robot: Name of the robot; optional if the log has a single robot.

    Raises:
        OSError: There is no such file.
        KeyError: There is no such robot.
    """
    return _read(path, robot, "ticks", tick_type)


def read_points(path: Path | str, robot: str = "") -> NDArray[np.void]:
    """Return the setpoints that clients have sent, a structured array of `point_type`.

    Arguments and errors as in `read_ticks`.
    """
    return _read(path, robot, "points", point_type)


def read_events(path: Path | str) -> list[dict[str, Any]]:
    """Return the events of a log, each with `time` [s], `robot` and `event`."""
    return [json.loads(line) for line in Path(path).read_text("utf-8").splitlines()]


def _read(path: Path | str, robot: str, what: str, kind_of: Callable[[int], np.dtype[np.void]]) -> NDArray[np.void]:
    with Path(path).open(encoding="utf-8") as file:
        start = json.loads(file.readline())
    dofs: dict[str, int] = start["dof"]
    name = robot or next(iter(dofs))
    kind = kind_of(dofs[name])
    content = _beside(Path(path), name, what).read_bytes()
    return np.frombuffer(content[: len(content) // kind.itemsize * kind.itemsize], kind)


def _beside(path: Path, robot: str, what: str) -> Path:
    return path.with_name(f"{path.name}.{robot}.{what}")


class RobotLog:
    """Writes the files of a log; without a path, it writes nothing."""

    def __init__(self, path: Path | None, dofs: Mapping[str, int], **about: Any) -> None:
        """Open the files.

        Args:
            path: Path of the JSON lines; None to log nothing.
            dofs: Number of joints by robot.
            about: Further fields of the first line.

        Raises:
            OSError: A file cannot be written.
        """
        self._text: TextIO | None = None
        self._next_flush = 0.0
        if path is not None:
            self._text = path.open("w", encoding="utf-8")
            kinds = {"ticks": tick_type, "points": point_type}
            self._tables = {
                (name, what): _Table(_beside(path, name, what), kind(dof))
                for name, dof in dofs.items()
                for what, kind in kinds.items()
            }
            self.note("", "start", dof=dict(dofs), **about)

    def note(self, robot: str, event: str, **values: Any) -> None:
        """Log an event with JSON-compatible values."""
        if self._text is not None:
            line = {"time": time.monotonic(), "robot": robot, "event": event, **values}
            self._text.write(json.dumps(line) + "\n")
            self._text.flush()

    def tick(self, robot: str, row: tuple[Any, ...]) -> None:
        """Log a tick with the fields of `tick_type`."""
        if self._text is not None:
            self._tables[robot, "ticks"].append(row)

    def point(self, robot: str, joints: ArrayLike, torques: ArrayLike) -> None:
        """Log a received setpoint: joints [rad] or torques [N·m], and NaN for the others."""
        if self._text is not None:
            self._tables[robot, "points"].append((time.monotonic(), joints, torques))

    def flush(self, now: float) -> None:
        """Write the entries that have waited for `FLUSH` seconds."""
        if self._text is None or now < self._next_flush:
            return
        self._next_flush = now + FLUSH
        for table in self._tables.values():
            table.flush()

    def close(self) -> None:
        """Write the remaining entries; closing twice is harmless."""
        if self._text is not None:
            self._next_flush = 0.0
            self.flush(0.0)
            self._text.close()
            for table in self._tables.values():
                table.close()
            self._text = None


class _Table:
    """Rows on their way into a file; each is converted when it comes, so that no tick has to convert many."""

    def __init__(self, path: Path, kind: np.dtype[np.void]) -> None:
        self._file = path.open("wb")
        self._rows, self._count = np.empty(ROWS, kind), 0

    def append(self, row: tuple[Any, ...]) -> None:
        if self._count == ROWS:
            self.flush()
        self._rows[self._count] = row
        self._count += 1

    def flush(self) -> None:
        self._file.write(self._rows[: self._count].tobytes())
        self._file.flush()
        self._count = 0

    def close(self) -> None:
        self._file.close()
