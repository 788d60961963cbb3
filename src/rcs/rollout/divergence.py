"""The divergence of a replayed episode from the recorded one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.spatial import distance

Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Largest errors that do not count as divergence, in the order of `Divergence`."""

    max_joint_error: float = 0.02
    """Of any joint [rad]."""
    max_position_error: float = 0.005
    """Of the TCP [m]."""
    max_rotation_error: float = 0.05
    """Of the TCP [rad]."""
    max_object_position_error: float = 0.01
    """Of any object of the task [m]."""
    max_object_rotation_error: float = 0.1
    """Of any object of the task [rad]."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: One is negative or not a number.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not value >= 0:
                raise InvalidSetup(f"{field.name} is {value}; valid is 0 and more.")


@dataclass(frozen=True, kw_only=True)
class Trace:
    """What an episode did, row by row."""

    joints: Values
    """Joints of all robots, (rows, n) [rad]."""
    tcps: Values
    """TCP poses of all robots, (rows, robots, 7) [m], xyzw."""
    objects: Values
    """Poses of all objects, (rows, objects, 7) [m], xyzw."""

    @staticmethod
    def of(rows: Sequence[Trace]) -> Trace:
        """Stack single rows, whose arrays lack the first axis."""
        names = [field.name for field in dataclasses.fields(Trace)]
        return Trace(**{name: np.stack([getattr(row, name) for row in rows]) for name in names})


@dataclass(frozen=True, kw_only=True)
class Divergence:
    """Errors per row; the largest of all joints, robots or objects."""

    joints: Values
    """[rad], (rows,)."""
    position: Values
    """Of the TCP [m], (rows,)."""
    rotation: Values
    """Of the TCP [rad], (rows,)."""
    object_position: Values
    """[m], (rows,); empty where the task has no objects."""
    object_rotation: Values
    """[rad], (rows,); empty where the task has no objects."""

    @staticmethod
    def between(recorded: Trace, replayed: Trace) -> Divergence:
        """Compare the rows that two episodes share."""
        rows = min(len(recorded.joints), len(replayed.joints))
        tcps = distance(recorded.tcps[:rows], replayed.tcps[:rows]).max(axis=1)
        objects = np.empty((0, 2))
        if recorded.objects.shape[1]:
            objects = distance(recorded.objects[:rows], replayed.objects[:rows]).max(axis=1)
        return Divergence(
            joints=np.abs(recorded.joints[:rows] - replayed.joints[:rows]).max(axis=1),
            position=tcps[:, 0],
            rotation=tcps[:, 1],
            object_position=objects[:, 0],
            object_rotation=objects[:, 1],
        )

    @property
    def errors(self) -> dict[str, Values]:
        """All errors by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def first_beyond(self, tolerance: Tolerance) -> tuple[int, str] | None:
        """Return the first row beyond the tolerance and the name of its error; None if there is none."""
        limits = dataclasses.astuple(tolerance)  # in the order of the errors
        beyond = [
            (np.flatnonzero(v > limit), name) for (name, v), limit in zip(self.errors.items(), limits, strict=True)
        ]
        return min(((int(rows[0]), name) for rows, name in beyond if len(rows)), key=lambda row: row[0], default=None)

    def summary(self) -> dict[str, dict[str, float] | None]:
        """Return largest and median error of each kind as JSON values; None if there is nothing to measure."""
        return {
            name: {"max": float(values.max()), "median": float(np.median(values))} if len(values) else None
            for name, values in self.errors.items()
        }

    def to_json(self) -> dict[str, Any]:
        """Return all errors by row as JSON values."""
        return {name: values.tolist() for name, values in self.errors.items()}
