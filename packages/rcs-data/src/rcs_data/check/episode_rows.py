"""The rows of an episode, as its checks need them: times, flags and joints, and the state of each image."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.check.report import Finding, Severity
from rcs_data.files.feature import SIMULATED_TIME, Feature
from rcs_data.files.flags import camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.files.layout import STEPS_FILE
from rcs_data.read.content import flat_numbers


@dataclass(frozen=True)
class EpisodePlace:
    """The place of an episode, for findings: the dataset's folder, its own folder, and its id."""

    root: Path
    folder: Path
    id: str

    def finding(
        self,
        severity: Severity,
        kind: str,
        message: str,
        *,
        file: str = STEPS_FILE,
        rows: tuple[int, int] | None = None,
    ) -> Finding:
        """Return a finding in this episode; `file` is a name in its folder, `rows` the first and last."""
        path = str((self.folder / file).relative_to(self.root))
        return Finding(severity=severity, kind=kind, episode=self.id, file=path, message=message, rows=rows)

    def warning(self, kind: str, message: str, rows: NDArray[np.intp] | None = None) -> Finding:
        """Return a warning about steps, from the first to the last of some rows."""
        place = None if rows is None or not len(rows) else (int(rows[0]), int(rows[-1]))
        return self.finding("warning", kind, message, rows=place)


@dataclass
class FrameLog:
    """The state of one image feature in each row."""

    is_new: list[bool] = field(default_factory=list[bool])
    """Whether the row has a new image."""
    is_same: list[bool] = field(default_factory=list[bool])
    """Whether the new image equals the one before it byte for byte."""
    is_black: list[bool] = field(default_factory=list[bool])
    """Whether the new image is black; False where images were not decoded."""
    last: bytes | None = None
    """The latest image."""


class EpisodeRows:
    """The columns of times, flags and joints, and the state of each image per row."""

    def __init__(self, info: DatasetInfo) -> None:
        self.info = info
        self.length = 0
        self.about: dict[str, Any] = {}
        self.frames = {f.key: FrameLog() for f in info.features if f.is_image}
        self.wanted = [f.key for f in info.features if f.is_time or f.is_flags or is_joints(f)]
        """Columns that are kept: others, such as states of the simulation, may be large."""
        self.numbers = pa.table({})
        """These columns, once they are read."""

    def column(self, key: str) -> NDArray[Any] | None:
        """Return a column, shape (length, *feature.shape); None if the dataset has no such key."""
        if key not in self.numbers.column_names:
            return None
        feature, column = self.info.feature(key), self.numbers.column(key)
        # Times that were not measured are NaN.
        return column.to_numpy() if feature.is_time else flat_numbers(column).reshape(-1, *feature.shape)

    @property
    def joints(self) -> list[str]:
        """Keys of measured joint positions, one per arm."""
        return [feature.key for feature in self.info.features if is_joints(feature)]

    @property
    def cameras(self) -> dict[str, list[str]]:
        """The keys of the images of each camera."""
        cameras: dict[str, list[str]] = {}
        for key in self.frames:
            cameras.setdefault(camera_of(key) or key, []).append(key)
        return cameras

    def seconds_per_step(self) -> NDArray[np.float64]:
        """Return how long each step took [s], shape (length - 1,), at least the nominal period."""
        nominal = np.full(max(self.length - 1, 0), 1 / self.info.frequency)
        clock = self.column(self.clock) if self.clock is not None else None
        if clock is None:
            return nominal
        measured = np.diff(clock)
        return np.where(measured > nominal, measured, nominal)  # the nominal period where NaN

    @property
    def clock(self) -> str | None:
        """The column of the robot's time; None if there is none.

        Simulated time, unless the simulation runs in real time: the wall clock only says how fast it computed.
        """
        is_realtime = self.info.setup.get("stepping") == "realtime"
        for key in ("time/monotonic",) if is_realtime else (SIMULATED_TIME, "time/monotonic"):
            if key in self.numbers.column_names:
                return key
        return None


def is_joints(feature: Feature) -> bool:
    """Whether a feature has an arm's measured joint positions."""
    return feature.key.startswith("observation/") and feature.key.rsplit("/", 1)[-1] == "joints"
