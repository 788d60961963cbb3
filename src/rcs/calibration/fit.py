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

LENS = 3
"""Numbers of a lens that may be fitted besides: share by which the focal lengths are longer, and how far the principal
point is off [px], in x and y."""

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
    lens: NDArray[np.float64] | None = None
    """What the lens has more than the given one, (LENS,); None where it is not fitted."""

    def moved(self, step: NDArray[np.float64]) -> Guess:
        """Return a guess nearby: both poses moved by twists in their own frames, (12,) or (12 + LENS,)."""
        lens = None if self.lens is None else self.lens + step[12:]
        return Guess(self.camera * Pose.exp(step[:6]), self.board * Pose.exp(step[6:12]), lens)

    def boards_in_camera(self, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the board is in the optical frame, (n, 4, 4), from poses of its anchor in the mount."""
        return self.camera.inverse().matrix @ anchors @ self.board.matrix

    @property
    def size(self) -> int:
        """How many numbers are fitted."""
        return 12 if self.lens is None else 12 + LENS


def residuals(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return how far corners are expected from where they were seen [px], (n, 4, 2)."""
    expected = project(guess.boards_in_camera(seen.anchors), seen.points) * seen.focal
    if guess.lens is not None:
        expected = expected * (1 + guess.lens[0]) + guess.lens[1:]
    return expected - seen.rays * seen.focal


def tag_errors(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return the root of the mean squared distance of each tag's corners [px], (n,)."""
    return np.sqrt((residuals(guess, seen) ** 2).sum(axis=-1).mean(axis=-1))


def refine(start: Guess, seen: Sightings, *, is_robust: bool = False) -> Guess:
    """Return the guess with the least squares, found from one nearby.

    Args:
        start: Where to begin.
        seen: What was seen.
        is_robust: Whether what is far off counts little; else all counts by its square.
    """
    found = package("scipy.optimize").least_squares(
        lambda step: residuals(start.moved(step), seen).ravel(),
        np.zeros(start.size),
        x_scale="jac",
        loss="cauchy" if is_robust else "linear",
        f_scale=_SOFT,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
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


def clustered_covariance(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    """Return the covariance of the fitted numbers, (size, size), with errors that the corners of a view share.

    What the robot is off in one view is common to all corners of it, so they are no independent observations (the
    cluster-robust estimator: Cameron and Miller, "A practitioner's guide to cluster-robust inference", 2015).
    """
    slopes, errors = jacobian(guess, seen), residuals(guess, seen).ravel()
    inverse = np.linalg.pinv(slopes.T @ slopes)
    scores = slopes * errors[:, None]
    rows = np.repeat(seen.view, 8)
    groups = np.array([scores[rows == view].sum(axis=0) for view in np.unique(rows)])
    count, size = len(groups), guess.size
    correction = count / max(count - 1, 1) * (len(errors) - 1) / max(len(errors) - size, 1)
    return correction * inverse @ groups.T @ groups @ inverse


def moved_by(of: Pose, to: Pose) -> NDArray[np.float64]:
    """Return the way from one pose to another nearby: translation [m] and rotation vector [rad] in its frame, (6,)."""
    step = of.inverse() * to
    return np.concatenate([step.translation, step.rotvec])
