"""Least squares of the distances between corners seen and expected, over the poses of camera and board.

In `fit_with_robot` the robot is off as well: its flange by another small twist in every view. That moves all corners of
the board in the view together. Fitted as if each corner were off by itself, they drag the camera along and are believed
too much. Here the errors of a view have the covariance `corner² I + K diag(robot²) Kᵀ`, where K is how corners move
with the flange. Both sizes are found together with the poses, by restricted maximum likelihood (Patterson and Thompson,
"Recovery of inter-block information when block sizes are unequal", Biometrika 58, 1971).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import project
from rcs.calibration.rig import Arrangement, View
from rcs.extras import package_of
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
    """Place of the camera: on the gripper ("eye-in-hand") or beside the robot ("eye-to-hand")."""

    @staticmethod
    def of(board: Board, views: Sequence[View], arrangement: Arrangement, intrinsics: Intrinsics) -> Sightings:
        """Collect what was seen.

        Args:
            board: The board.
            views: The views.
            arrangement: Whether the camera is on the gripper or beside the robot.
            intrinsics: Intrinsics of their pictures.
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
    """Values of the quantities that are fitted."""

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
        seen: The sightings.
    """
    found = package_of("calibration", "scipy.optimize").least_squares(
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


RobotError = tuple[float, float]
"""Standard deviations of what a robot is off in a view: of the flange's position along each of its axes [m], and of its
rotation about each [rad]."""

_LEAST, _MOST = np.array([1e-3, 1e-7, 1e-7]), np.array([100.0, 0.1, 0.3])
"""Bounds of the standard deviations: of a corner [px], and of the robot [m, rad]. Smaller ones are as good as none."""
_ROUNDS = 10
"""Most times that the sizes are found anew; it takes two or three."""
_STILL = 1e-7
"""Step from which the poses have been found [m, rad]."""


@dataclass(frozen=True, eq=False)
class RobotFit:
    """The most likely poses of camera and board, and sizes of the errors."""

    guess: Guess
    """The poses, and how far what is given is off, if that is fitted."""
    covariance: NDArray[np.float64]
    """Covariance of the numbers of `Guess.moved`, (size, size)."""
    without: list[Guess]
    """The same without each of the views, in the order of their numbers."""
    robot: RobotError
    """Error of the robot in a view."""
    tag_errors: NDArray[np.float64]
    """Root of the mean squared distance of each tag's corners [px], (n,), less what the robot is off in the view."""


def fit_with_robot(start: Guess, seen: Sightings, robot: RobotError | None = None) -> RobotFit:
    """Find the poses of camera and board.

    Args:
        start: Where to begin, nearby.
        seen: The sightings, without wrong tags.
        robot: Error of the robot; None to find that out, too.
    """
    guess, sizes = start, None
    for _ in range(_ROUNDS):
        linear = _Linear.of(guess, seen)
        sizes = linear.likely(robot, sizes)
        normal = linear.normal(sizes)
        step = normal.step()
        guess = guess.moved(step)
        if np.abs(step[:12]).max() < _STILL:
            break
    assert sizes is not None, "there are rounds"
    normal = _Linear.of(guess, seen).normal(sizes)
    return RobotFit(
        guess=guess,
        covariance=np.linalg.inv(normal.precision.sum(axis=0)),
        without=[guess.moved(normal.step(without=i)) for i in range(len(normal.slope))],
        robot=(float(sizes[1]), float(sizes[2])),
        tag_errors=_tag_errors(guess, seen, sizes),
    )


@dataclass(frozen=True, eq=False)
class _Normal:
    """Contributions of the views to the normal equations of a guess."""

    precision: NDArray[np.float64]
    """(v, size, size)."""
    slope: NDArray[np.float64]
    """(v, size)."""
    rest: float
    """Further terms of minus twice the logarithm of the likelihood."""

    def step(self, *, without: int | None = None) -> NDArray[np.float64]:
        """Return the step to the most likely guess, (size,), of all views or without one."""
        left = slice(0, 0) if without is None else slice(without, without + 1)
        precision = self.precision.sum(axis=0) - self.precision[left].sum(axis=0)
        return -np.linalg.solve(precision, self.slope.sum(axis=0) - self.slope[left].sum(axis=0))

    def unlikelihood(self) -> float:
        """Return minus twice the logarithm of the restricted likelihood, but for a constant."""
        precision, slope = self.precision.sum(axis=0), self.slope.sum(axis=0)
        return self.rest + float(np.linalg.slogdet(precision)[1] - slope @ np.linalg.solve(precision, slope))


@dataclass(frozen=True, eq=False)
class _Linear:
    """The residuals about a guess, turned in each view such that a moving flange explains six of them and no others.

    It is Q of K = Q R that turns them.
    """

    r: NDArray[np.float64]
    """How the six change with the flange, (v, 6, 6)."""
    six: NDArray[np.float64]
    """They [px], and how they change with the guess, (v, 6, 1 + size)."""
    others: NDArray[np.float64]
    """Products of the others and of their changes with one another, (v, 1 + size, 1 + size)."""
    count: int
    """Number of the others."""

    @staticmethod
    def of(guess: Guess, seen: Sightings) -> _Linear:
        """Take them apart."""
        every = np.column_stack([residuals(guess, seen).ravel(), jacobian(guess, seen)])
        flange, rows = flange_jacobian(guess, seen), np.repeat(seen.view, 8)
        parts: list[tuple[Any, ...]] = []
        for view in np.unique(rows):
            own = every[rows == view]
            q, r = np.linalg.qr(flange[rows == view])
            six = q.T @ own
            others = own - q @ six
            parts.append((r, six, others.T @ others))
        r, six, products = (np.array(part) for part in zip(*parts, strict=True))
        return _Linear(r, six, products, len(every) - 6 * len(parts))

    def normal(self, sizes: NDArray[np.float64]) -> _Normal:
        """Return the normal equations.

        Args:
            sizes: Standard deviations of a corner [px], and of the robot [m, rad], (3,).
        """
        by_robot = self.r * np.repeat(sizes[1:], 3)
        root = np.linalg.cholesky(by_robot @ np.swapaxes(by_robot, -1, -2) + sizes[0] ** 2 * np.eye(6))
        white = np.linalg.solve(root, self.six)
        products = np.swapaxes(white, -1, -2) @ white + self.others / sizes[0] ** 2
        volume = float(np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum() + self.count * np.log(sizes[0]))
        return _Normal(products[:, 1:, 1:], products[:, 1:, 0], 2 * volume + float(products[:, 0, 0].sum()))

    def likely(self, robot: RobotError | None, near: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return the most likely sizes of the errors, as `normal` takes them.

        Args:
            robot: Error of the robot; None to find that out, too.
            near: Where to begin; None for as if only the robot were off.
        """
        if near is None:
            corner = np.sqrt(self.others[:, 0, 0].sum() / max(self.count, 1))
            flanges = np.linalg.solve(self.r, self.six[..., :1]).reshape(-1, 2, 3)
            near = np.array([corner, *np.sqrt((flanges**2).mean(axis=(0, 2)))])
        known = () if robot is None else tuple(np.clip(robot, _LEAST[1:], _MOST[1:]))
        free = slice(0, 3 - len(known))
        found = package_of("calibration", "scipy.optimize").minimize(
            lambda logarithms: self.normal(np.array([*np.exp(logarithms), *known])).unlikelihood(),
            np.log(np.clip(near, 2 * _LEAST, _MOST))[free],
            method="L-BFGS-B",
            bounds=np.log(np.stack([_LEAST, _MOST], axis=-1))[free],
        )
        return np.array([*np.exp(found.x), *known])


def _tag_errors(guess: Guess, seen: Sightings, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what remains of each tag's error once the most likely twist of the flange is taken out, (n,) [px]."""
    errors = residuals(guess, seen).reshape(-1, 8)
    by_robot = flange_jacobian(guess, seen).reshape(-1, 8, 6) * np.repeat(sizes[1:], 3)
    for view in np.unique(seen.view):
        own = by_robot[seen.view == view].reshape(-1, 6)
        covariance = own @ own.T + sizes[0] ** 2 * np.eye(len(own))
        left = sizes[0] ** 2 * np.linalg.solve(covariance, errors[seen.view == view].ravel())
        errors[seen.view == view] = left.reshape(-1, 8)
    return np.sqrt((errors**2).sum(axis=-1) / 4)
