"""The pose of a camera from views of a board at many poses of the robot, its error, and a check by other views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import WRONG, board_poses, limit_of, rms
from rcs.calibration.closed_form import rigid, start
from rcs.calibration.fit import (
    GIVEN,
    Guess,
    RobotError,
    RobotFit,
    Sightings,
    fit_with_robot,
    moved_by,
    refine,
    tag_errors,
)
from rcs.calibration.motion import motions
from rcs.calibration.rig import Arrangement, Rig, View
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, Pose

MOST_WRONG = 0.35
"""Share of tags that may be wrong."""
TOO_MUCH = 1.0
"""Root of the mean squared residual from which something is amiss [px]."""
ROBOT_OFF = (1e-3, np.deg2rad(0.25))
"""Largest error of a robot in a view along and about each axis before something is amiss [m, rad]."""
FOCAL_OFF = 0.004
"""Share by which the given focal lengths may differ from those that explain the pictures best."""
CENTRE_OFF = 3.0
"""How far the given principal point may be from the one that explains them best [px]."""
SIZE_OFF = 0.004
"""Share by which the given board may be smaller or larger than the one that explains the motions best."""
SURE = 4.0
"""Standard deviations from which a difference is no chance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandEye:
    """Where a camera is, and how well that is known."""

    arrangement: Arrangement
    """Place of the camera: on the gripper ("eye-in-hand") or beside the robot ("eye-to-hand")."""
    camera_in_mount: Pose
    """Pose of the optical frame in the flange (eye in hand) or in the base (eye to hand)."""
    board_in_anchor: Pose
    """Pose of the board in the base (eye in hand) or in the flange (eye to hand)."""
    covariance: NDArray[np.float64]
    """Covariance of `camera_in_mount`, (6, 6): translation [m], rotation vector [rad], in the optical frame; from what
    leaving out each view changes (the jackknife)."""
    views: int
    """Views that were used."""
    tags: int
    """Tags that were used."""
    rejected: tuple[tuple[int, int], ...]
    """Tags that were not: number of the view, number of the tag."""
    robot: RobotError
    """Error that the robot seems to have in a view, along [m] and about [rad] each axis of the flange; or as given."""
    residual_px: float
    """Root of the mean squared distance between a corner seen and expected, less what the robot is off [px]."""
    held_out_px: float
    """Root of the mean squared distance between a corner seen and expected in views that were left out [px]."""
    held_out_mm: float
    """Root mean square of how far boards seen in views that were left out are from where they are expected [mm]. It has
    the errors of robot and detection in that one view, too, so the camera's pose is known better than that."""
    held_out_degrees: float
    """The same of their rotations [degrees]."""
    given_off: NDArray[np.float64]
    """Errors of the given lens and board that would explain the pictures better, (4,): share by which focal lengths are
    longer, how far the principal point is off in x and y [px], and share by which the board is larger."""
    alarms: tuple[str, ...]
    """Problems found, in words; empty if all is well."""

    @property
    def sigma_mm(self) -> float:
        """Standard deviation of the camera's position, over all directions [mm]."""
        return 1000 * float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def sigma_degrees(self) -> float:
        """Standard deviation of its rotation, about all axes [degrees]."""
        return float(np.rad2deg(np.sqrt(np.trace(self.covariance[3:, 3:]))))

    def __str__(self) -> str:
        """Return the result in words."""
        x, y, z = 1000 * self.camera_in_mount.translation
        mount = "flange" if self.arrangement == "eye-in-hand" else "base"
        lines = [
            f"camera in the {mount}: ({x:.1f}, {y:.1f}, {z:.1f}) mm, rpy "
            + ", ".join(f"{angle:.2f}" for angle in np.rad2deg(self.camera_in_mount.rpy))
            + " degrees",
            f"standard deviation: {self.sigma_mm:.3f} mm, {self.sigma_degrees:.4f} degrees",
            f"the robot seems to be off by {_words(self.robot)} in each view, along and about each axis",
            f"left-out views: {self.held_out_mm:.2f} mm, {self.held_out_degrees:.3f} degrees, "
            f"{self.held_out_px:.2f} px; residual {self.residual_px:.2f} px",
            f"used {self.tags} tags in {self.views} views, {len(self.rejected)} rejected",
            *(f"ALARM: {alarm}" for alarm in self.alarms),
        ]
        return "\n".join(lines)


def hand_eye(
    board: Board,
    views: Sequence[View],
    arrangement: Arrangement,
    intrinsics: Intrinsics,
    robot: RobotError | None = None,
) -> HandEye:
    """Find where a camera is.

    The poses of camera and board are found that are most likely where corners are seen a little off and the robot is,
    too, in each view anew (`fit_with_robot`). A robust start (`start`) and a robust loss find out which tags are wrong;
    these are left out, and count for nothing.

    Args:
        board: The board; a wrong size of its tags is a wrong size of everything.
        views: Views from many poses; those without tags do not count.
        arrangement: Whether the camera is on the gripper.
        intrinsics: Intrinsics of the pictures.
        robot: Error of the robot in a view, along [m] and about [rad] each axis of the flange; None to find that out
            from the views.

    Raises:
        InvalidSetup: The views do not suffice, and the message says which motions are missing; or they contradict each
            other; or `robot` is negative or not finite.
    """
    if robot is not None and not (np.isfinite(robot).all() and min(robot) >= 0):
        raise InvalidSetup(f"robot is {robot}; valid are two standard deviations from 0 [m, rad], or None.")
    usable = [i for i, view in enumerate(views) if len(view.detections)]
    chosen = [views[i] for i in usable]
    motions([view.flange_in_base for view in chosen]).require_enough()
    every = Sightings.of(board, chosen, arrangement, intrinsics)
    fit, is_right = _fit(board, chosen, every, arrangement, intrinsics, robot)
    seen, wrong = every[is_right], every[~is_right]
    kept = np.unique(seen.view)
    given_off, alarms = _check_given(fit.guess, seen, robot)
    residual = rms(fit.tag_errors)
    if robot is None and (fit.robot[0] > ROBOT_OFF[0] or fit.robot[1] > ROBOT_OFF[1]):
        alarms = (
            f"the robot seems to be off by {_words(fit.robot)} in each view; usual is below {_words(ROBOT_OFF)}. It "
            "had not come to rest, its own calibration is off, or camera or board moved a little",
            *alarms,
        )
    if residual > TOO_MUCH:
        alarms = (
            f"the residual is {residual:.2f} px; usual is below {TOO_MUCH:g} px. The intrinsics are off, the board is "
            "another or not flat, or the pictures are blurred",
            *alarms,
        )
    held_out: list[NDArray[np.float64]] = []
    boards: list[tuple[float, float]] = []
    for without, view in zip(fit.without, kept, strict=True):
        own = seen[seen.view == view]
        held_out.append(tag_errors(without, own))
        right = np.isin(chosen[view].detections.ids, own.ids)
        shown = replace(chosen[view], detections=chosen[view].detections[right])
        boards.append(board_offset(without, board, shown, arrangement, intrinsics))
    millimetres, degrees = (rms(values) for values in zip(*boards, strict=True))
    return HandEye(
        arrangement=arrangement,
        camera_in_mount=fit.guess.camera,
        board_in_anchor=fit.guess.board,
        covariance=_jackknife(fit),
        views=len(kept),
        tags=len(seen),
        rejected=tuple((usable[view], int(number)) for view, number in zip(wrong.view, wrong.ids, strict=True)),
        robot=fit.robot,
        residual_px=residual,
        held_out_px=rms(np.concatenate(held_out)),
        held_out_mm=millimetres,
        held_out_degrees=degrees,
        given_off=given_off,
        alarms=alarms,
    )


def _fit(
    board: Board,
    views: Sequence[View],
    every: Sightings,
    arrangement: Arrangement,
    intrinsics: Intrinsics,
    robot: RobotError | None,
) -> tuple[RobotFit, NDArray[np.bool_]]:
    """Return the fit of the tags that are right, and which these are of all, (n,)."""
    guess = refine(start(board, views, arrangement, intrinsics), every)
    errors = tag_errors(guess, every)
    is_right = errors < limit_of(errors)
    while True:
        if np.mean(~is_right) > MOST_WRONG:
            raise InvalidSetup(
                f"{int(np.sum(~is_right))} of {len(every)} tags are not where the others say, by more than "
                f"{WRONG[1]:g} times the median of {float(np.median(errors)):.2f} px. Did the board or the camera move?"
            )
        seen = every[is_right]
        motions([views[i].flange_in_base for i in np.unique(seen.view)]).require_enough()
        fit = fit_with_robot(guess, seen, robot)
        # A tag that a poor robot hid shows beside the others of its view; it spoils these, so one at a time.
        worst = {view: fit.tag_errors[seen.view == view].max() for view in np.unique(seen.view)}
        is_wrong = fit.tag_errors > limit_of(fit.tag_errors)
        is_wrong &= fit.tag_errors == [worst[view] for view in seen.view]
        if not is_wrong.any():
            return fit, is_right
        is_right[is_right] = ~is_wrong


def _words(robot: RobotError) -> str:
    return f"{1000 * robot[0]:.2f} mm and {np.rad2deg(robot[1]):.3f} degrees"


def _jackknife(fit: RobotFit) -> NDArray[np.float64]:
    """Return the covariance of the camera's pose (Efron, "The jackknife", 1982)."""
    moved = np.array([moved_by(fit.guess.camera, other.camera) for other in fit.without])
    moved = moved - moved.mean(axis=0)
    covariance = (len(moved) - 1) / len(moved) * moved.T @ moved
    return (covariance + covariance.T) / 2


def _check_given(
    guess: Guess, seen: Sightings, robot: RobotError | None
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return how far what is given is off, (GIVEN,), and alarms where that is no chance."""
    free = fit_with_robot(replace(guess, given=np.zeros(GIVEN)), seen, robot)
    assert free.guess.given is not None, "it was given"
    off, sigma = free.guess.given, np.sqrt(np.diag(free.covariance)[12:])
    is_sure = np.abs(off) > SURE * sigma
    alarms: list[str] = []
    if abs(off[0]) > FOCAL_OFF and is_sure[0]:
        alarms.append(
            f"focal lengths that are {abs(off[0]):.1%} {'longer' if off[0] > 0 else 'shorter'} explain the pictures "
            f"better (standard deviation {sigma[0]:.2%}); calibrate the intrinsics"
        )
    if np.hypot(*off[1:3]) > CENTRE_OFF and is_sure[1:3].any():
        alarms.append(
            f"a principal point that is ({off[1]:+.1f}, {off[2]:+.1f}) px off explains the pictures better; calibrate "
            "the intrinsics"
        )
    if abs(off[3]) > SIZE_OFF and is_sure[3]:
        alarms.append(
            f"a board that is {abs(off[3]):.1%} {'larger' if off[3] > 0 else 'smaller'} explains the motions better "
            f"(standard deviation {sigma[3]:.2%}); measure a tag"
        )
    return off, tuple(alarms)


@dataclass(frozen=True, kw_only=True)
class Verification:
    """How well a calibration holds. Each number is the median over all views."""

    views: int
    """Views that showed the board."""
    pixels: float
    """Distance of a tag's corners from where they are expected [px]."""
    millimetres: float
    """Distance of the board from where it is expected [mm], with the error of seeing it in one view."""
    degrees: float
    """The same of its rotation [degrees]."""


def verify(rig: Rig, board: Board, views: Sequence[View]) -> Verification:
    """Compare views with what is expected of a camera and a board whose places are known.

    Args:
        rig: Where camera and board are, and how the camera sees.
        board: The board.
        views: The views; those without tags do not count.

    Raises:
        InvalidSetup: The place of the board is not known, or no view shows it.
    """
    if rig.board_in_anchor is None:
        raise InvalidSetup("The place of the board is not known, so there is nothing to compare with.")
    usable = [view for view in views if len(view.detections)]
    if not usable:
        raise InvalidSetup(f"None of {len(views)} pictures shows the board; is it where it was?")
    guess = Guess(rig.camera_in_mount, rig.board_in_anchor)
    off = [board_offset(guess, board, view, rig.arrangement, rig.intrinsics) for view in usable]
    millimetres, degrees = (float(np.median(values)) for values in zip(*off, strict=True))
    pixels = tag_errors(guess, Sightings.of(board, usable, rig.arrangement, rig.intrinsics))
    return Verification(views=len(usable), pixels=float(np.median(pixels)), millimetres=millimetres, degrees=degrees)


def board_offset(
    guess: Guess, board: Board, view: View, arrangement: Arrangement, intrinsics: Intrinsics
) -> tuple[float, float]:
    """Return the offset of the board in a view from its expected pose [mm, degrees].

    Args:
        guess: Poses of camera and board.
        board: The board.
        view: The view.
        arrangement: Whether the camera is on the gripper or beside the robot.
        intrinsics: Intrinsics of the camera.
    """
    expected = rigid(guess.boards_in_camera(view.anchor_in_mount(arrangement)))
    found = [rigid(one.board_in_camera) for one in board_poses(board, view.detections, intrinsics)]
    # A flipped board is an error of that picture alone: the one that is meant is the nearer one.
    nearest = min((moved_by(expected, one) for one in found), key=lambda step: float(np.linalg.norm(step[3:])))
    return 1000 * float(np.linalg.norm(nearest[:3])), float(np.rad2deg(np.linalg.norm(nearest[3:])))
