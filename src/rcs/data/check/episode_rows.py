"""What is kept of an episode's rows while its files are read, for the checks that come after the bytes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs.data.check.report import Finding, Severity
from rcs.data.content import flat_numbers
from rcs.data.feature import Feature
from rcs.data.flags import camera_of, companion
from rcs.data.info import DatasetInfo
from rcs.data.layout import STEPS_FILE

SIMULATED_TIME = "simulated_time"


@dataclass(frozen=True)
class EpisodePlace:
    """Where an episode is: names it in findings."""

    root: Path
    """The dataset's folder."""
    folder: Path
    """The episode's folder."""

    @property
    def id(self) -> str:
        """The episode's id."""
        return self.folder.name

    def finding(
        self,
        severity: Severity,
        kind: str,
        message: str,
        *,
        file: str = STEPS_FILE,
        rows: tuple[int, int] | None = None,
    ) -> Finding:
        """Return a finding in this episode; `file` is a name in its folder, and rows come as first and last."""
        path = str((self.folder / file).relative_to(self.root))
        return Finding(severity=severity, kind=kind, episode=self.id, file=path, message=message, rows=rows)

    def warning(self, kind: str, message: str, rows: NDArray[np.intp] | None = None) -> Finding:
        """Return a warning about the steps, from the first to the last of some rows."""
        place = None if rows is None or not len(rows) else (int(rows[0]), int(rows[-1]))
        return self.finding("warning", kind, message, rows=place)


@dataclass
class FrameLog:
    """What each row says of one image feature."""

    is_new: list[bool] = field(default_factory=list[bool])
    """Whether the row has an image of its own."""
    is_same: list[bool] = field(default_factory=list[bool])
    """Whether it has one, and that is byte for byte the last one before it."""
    is_black: list[bool] = field(default_factory=list[bool])
    """Whether it has one that shows nothing; False where images were not decoded."""
    last: bytes | None = None
    """The last image so far."""


class EpisodeRows:
    """The columns that say when, how and whether the robot moved, and a line per row for each camera."""

    def __init__(self, info: DatasetInfo) -> None:
        """Start with no rows."""
        self.info = info
        self.length = 0
        self.about: dict[str, Any] = {}
        self.frames = {f.key: FrameLog() for f in info.features if f.is_image}
        self._parts: dict[str, list[NDArray[Any]]] = {f.key: [] for f in info.features if _is_wanted(f)}

    def add(self, rows: pa.Table) -> None:
        """Take the next rows."""
        self.length += rows.num_rows
        for key, parts in self._parts.items():
            column = rows.column(key)
            feature = self.info.feature(key)
            # Where a time was not measured there is NaN.
            parts.append(
                column.to_numpy() if feature.is_time else flat_numbers(column).reshape(-1, *feature.shape).copy()
            )

    def column(self, key: str) -> NDArray[Any] | None:
        """Return a column, shape (length, *feature.shape); None if the dataset has none of that key."""
        parts = self._parts.get(key)
        return np.concatenate(parts) if parts else None

    @property
    def joints(self) -> list[str]:
        """Keys of measured joint positions, one per arm."""
        return [key for key in self._parts if _is_joints(key)]

    @property
    def cameras(self) -> dict[str, list[str]]:
        """The keys of the images of each camera."""
        cameras: dict[str, list[str]] = {}
        for key in self.frames:
            cameras.setdefault(camera_of(key) or key, []).append(key)
        return cameras

    def flags(self, key: str) -> NDArray[np.uint8] | None:
        """Return the flags beside an image; None if there are none."""
        name = companion(key, self.info.features, "flags")
        return None if name is None else self.column(name)

    def seconds_per_step(self) -> NDArray[np.float64]:
        """Return how long each step took [s], shape (length - 1,), and never less than the rate says."""
        nominal = np.full(max(self.length - 1, 0), 1 / self.info.frequency)
        clock = self.column(self.clock) if self.clock is not None else None
        if clock is None:
            return nominal
        measured = np.diff(clock)
        return np.where(measured > nominal, measured, nominal)  # where one is NaN the rate holds

    @property
    def clock(self) -> str | None:
        """The column that says how much time passed for the robot; None if there is none.

        A simulation that does not run in real time has its own; there the wall clock says only how fast it computed.
        """
        is_realtime = self.info.setup.get("mode") == "realtime"
        for key in ("time/monotonic",) if is_realtime else (SIMULATED_TIME, "time/monotonic"):
            if key in self._parts:
                return key
        return None


def _is_joints(key: str) -> bool:
    return key.startswith("observation/") and key.rsplit("/", 1)[-1] == "joints"


def _is_wanted(feature: Feature) -> bool:
    return feature.is_time or feature.is_flags or feature.key == SIMULATED_TIME or _is_joints(feature.key)
