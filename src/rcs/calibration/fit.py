"""Least squares of the distances between corners seen and expected, over the poses of camera and board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import project
from rcs.calibration.packages import package
from rcs.calibration.rig import Arrangement, View
from rcs.spatial import Intrinsics, Pose

GIVEN = 4
"""Numbers of what is given that may be fitted besides: share by which the focal lengths are longer, how far the
principal point is off in x and y [px], and share by which the board is larger."""

_SOFT = 1.0
"""Distance from which the robust loss grows like the distance, not like its square [px]."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Every tag of every view, one per row."""

    view: NDArray[np.int_]
    """Its view, (n,)."""
    ids: NDArray[np.int_]
    """Its number, (n,)."""
    anchors: NDArray[np.float64]
    """Pose of what carries the board in what carries the camera, (n, 4, 4)."""
    points: NDArray[np.float64]
    """Its corners on the board [m], (n, 4, 3)."""
    rays: NDArray[np.float64]
    """Where they were seen, x / z and y / z, (n, 4, 2)."""
    focal: tuple[float, float]
    """Focal lengths [px]."""
    arrangement: Arrangement
    """What carries the camera."""

    @staticmethod
    def of(board: Board, views: Sequence[View], arrangement: Arrangement, intrinsics: Intrinsics) -> Sightings:
        """Collect what was seen.

        Args:
            board: The board.
            views: The views.
            arrangement: What carries the camera.
            intrinsics: Of their pictures.
        """
        anchors = [view.anchor_in_mount(arrangement) for view in views]
        counts = [len(view.detections) for view in views]
        ids = np.concatenate([np.empty(0, np.int_), *(view.detections.ids for view in views)])
        return Sightings(
            np.repeat(np.arange(len(views)), counts),
            ids,
            np.repeat(np.array(anchors).reshape(-1, 4, 4), counts, axis=0),
            board.corners_of(ids),
            np.concatenate([np.empty((0, 4, 2)), *(view.detections.rays(intrinsics) for view in views)]),
            (intrinsics.fx, intrinsics.fy),
            arrangement,
        )

    def __len__(self) -> int:
        """Return the number of tags."""
        return len(self.view)

    def __getitem__(self, rows: NDArray[np.bool_]) -> Sightings:
        """Return some of them."""
        return replace(
            self,
            view=self.view[rows],
            ids=self.ids[rows],
            anchors=self.anchors[rows],
            points=self.points[rows],
            rays=self.rays[rows],
        )


@dataclass(frozen=True, eq=False)
class Guess:
    """What is fitted."""

    camera: Pose
    """Pose of the camera in its mount."""
    board: Pose
    """Pose of the board in its anchor."""
    given: NDArray[np.float64] | None = None
    """How far what is given is off, (GIVEN,); None where that is not fitted."""

    def moved(self, step: NDArray[np.float64]) -> Guess:
        """Return a guess nearby: both poses moved by twists in their own frames, (12,) or (12 + GIVEN,)."""
        given = None if self.given is None else self.given + step[12:]
        return Guess(self.camera * Pose.exp(step[:6]), self.board * Pose.exp(step[6:12]), given)

    def boards_in_camera(self, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the board is in the optical frame, (n, 4, 4), from poses of its anchor in the mount."""
        return self.camera.inverse().matrix @ anchors @ self.board.matrix

    @property
    def size(self) -> int:
        """How many numbers are fitted."""
        return 12 if self.given is None else 12 + GIVEN


def residuals(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return how far corners are expected from where they were seen [px], (n, 4, 2)."""
    longer, *off, larger = (0.0,) * GIVEN if guess.given is None else guess.given
    expected = project(guess.boards_in_camera(seen.anchors), (1 + larger) * seen.points) * seen.focal
    return expected * (1 + longer) + off - seen.rays * seen.focal


def tag_errors(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return the root of the mean squared distance of each tag's corners [px], (n,)."""
    return np.sqrt((residuals(guess, seen) ** 2).sum(axis=-1).mean(axis=-1))


def refine(start: Guess, seen: Sightings) -> Guess:
    """Return the guess with the least squares, found from one nearby; what is far off counts little.

    Args:
        start: Where to begin.
        seen: What was seen.
    """
    found = package("scipy.optimize").least_squares(
        lambda step: residuals(start.moved(step), seen).ravel(),
        np.zeros(start.size),
        x_scale="jac",
        loss="cauchy",
        f_scale=_SOFT,
        max_nfev=100,
    )
    return start.moved(found.x)


def jacobian(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return how residuals change with the numbers of `Guess.moved` [px/m, px/rad], (n * 8, size), by differences."""
    width = 1e-6
    columns = [
        (residuals(guess.moved(step), seen) - residuals(guess.moved(-step), seen)).ravel() / (2 * width)
        for step in width * np.eye(guess.size)
    ]
    return np.stack(columns, axis=-1)


def flange_jacobian(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return how residuals change as the flange moves by a twist in its own frame [px/m, px/rad], (n * 8, 6)."""
    width = 1e-6

    def moved(step: NDArray[np.float64]) -> NDArray[np.float64]:
        twist = Pose.exp(step)
        is_in_hand = seen.arrangement == "eye-in-hand"
        anchors = twist.inverse().matrix @ seen.anchors if is_in_hand else seen.anchors @ twist.matrix
        return residuals(guess, replace(seen, anchors=anchors)).ravel()

    return np.stack([(moved(step) - moved(-step)) / (2 * width) for step in width * np.eye(6)], axis=-1)


def moved_by(of: Pose, to: Pose) -> NDArray[np.float64]:
    """Return the way from one pose to another nearby: translation [m] and rotation vector [rad] in its frame, (6,)."""
    step = of.inverse() * to
    return np.concatenate([step.translation, step.rotvec])
