"""Where a camera is: from views of a board at many poses of the robot, with what is known of the error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.calibration.board import Board
from rcs.calibration.fit import Guess, Sightings, clustered_covariance, moved_by, refine, tag_errors
from rcs.calibration.motion import motions
from rcs.calibration.rig import Arrangement, View
from rcs.calibration.start import start
from rcs.calibration.verify import board_offset
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, Pose

WRONG = (1.0, 4.0)
"""A tag is wrong if its error is larger than this [px], and than this times the median of all."""
MOST_WRONG = 0.35
"""Share of tags that may be wrong."""
TOO_MUCH = 1.0
"""Root of the mean squared residual from which something is amiss [px]."""
FOCAL_OFF = 0.004
"""Share by which the given focal lengths may differ from those that explain the pictures best."""
CENTRE_OFF = 3.0
"""How far the given principal point may be from the one that explains them best [px]."""
SURE = 4.0
"""Standard deviations from which a difference is no chance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandEye:
    """Where a camera is, and how well that is known."""

    arrangement: Arrangement
    """What carries the camera."""
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
    residual_px: float
    """Root of the mean squared distance between a corner seen and expected [px]."""
    held_out_px: float
    """The same of views that were left out [px]."""
    held_out_mm: float
    """Root mean square of how far boards seen in views that were left out are from where they are expected [mm]. It has
    the errors of robot and detection in that one view, too, so the camera's pose is known better than that."""
    held_out_degrees: float
    """The same of their rotations [degrees]."""
    focal_off: float
    """Share by which longer focal lengths explain the pictures better."""
    centre_off: tuple[float, float]
    """How far another principal point that explains them better is off [px]."""
    alarms: tuple[str, ...]
    """What is amiss, in words; empty if all is well."""

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
            f"left-out views: {self.held_out_mm:.2f} mm, {self.held_out_degrees:.3f} degrees, "
            f"{self.held_out_px:.2f} px; residual {self.residual_px:.2f} px",
            f"used {self.tags} tags in {self.views} views, {len(self.rejected)} rejected",
            *(f"ALARM: {alarm}" for alarm in self.alarms),
        ]
        return "\n".join(lines)


def hand_eye(board: Board, views: Sequence[View], arrangement: Arrangement, intrinsics: Intrinsics) -> HandEye:
    """Find where a camera is.

    The corners' distances from where they are expected are made least, over the poses of camera and board. A robust
    start (`start`) and a robust loss find out which tags are wrong; these are left out, and count for nothing.

    Args:
        board: The board; a wrong size of its tags is a wrong size of everything.
        views: Views from many poses; those without tags do not count.
        arrangement: Whether the camera is on the gripper.
        intrinsics: Of the pictures.

    Raises:
        InvalidSetup: The views cannot tell, and the message says which motions are missing; or they contradict each
            other.
    """
    usable = [i for i, view in enumerate(views) if len(view.detections)]
    chosen = [views[i] for i in usable]
    motions([view.flange_in_base for view in chosen]).require_enough()
    every = Sightings.of(board, chosen, arrangement, intrinsics)
    guess = refine(start(board, chosen, arrangement, intrinsics), every, is_robust=True)
    errors = tag_errors(guess, every)
    is_right = errors < max(WRONG[0], WRONG[1] * float(np.median(errors)))
    if np.mean(~is_right) > MOST_WRONG:
        raise InvalidSetup(
            f"{int(np.sum(~is_right))} of {len(every)} tags are not where the others say, by more than "
            f"{WRONG[1]:g} times the median of {float(np.median(errors)):.2f} px. Did the board or the camera move?"
        )
    seen = every[is_right]
    kept = np.unique(seen.view)
    motions([chosen[i].flange_in_base for i in kept]).require_enough()
    guess = refine(guess, seen)
    held_out = [_without(guess, seen, view) for view in kept]
    covariance = _jackknife(guess, [one.guess for one in held_out])
    focal_off, centre_off, alarms = _check_lens(guess, seen)
    residual = _rms(tag_errors(guess, seen))
    if residual > TOO_MUCH:
        alarms = (
            f"the residual is {residual:.2f} px; usual is below {TOO_MUCH:g} px. Intrinsics, the size of the board, or "
            "the robot's own calibration are off, or the robot had not come to rest",
            *alarms,
        )
    boards = [_board_error(one, board, chosen[view], arrangement, intrinsics, seen) for one, view in
              zip(held_out, kept, strict=True)]  # fmt: skip
    millimetres, degrees = (_rms(values) for values in zip(*boards, strict=True))
    wrong = every[~is_right]
    return HandEye(
        arrangement=arrangement,
        camera_in_mount=guess.camera,
        board_in_anchor=guess.board,
        covariance=covariance,
        views=len(kept),
        tags=len(seen),
        rejected=tuple((usable[view], int(number)) for view, number in zip(wrong.view, wrong.ids, strict=True)),
        residual_px=residual,
        held_out_px=_rms(np.concatenate([one.errors for one in held_out])),
        held_out_mm=millimetres,
        held_out_degrees=degrees,
        focal_off=focal_off,
        centre_off=centre_off,
        alarms=alarms,
    )


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """A view that was left out."""

    guess: Guess
    """Found without it."""
    view: int
    """Its number."""
    errors: NDArray[np.float64]
    """Errors of its tags [px], (n,)."""


def _without(guess: Guess, seen: Sightings, view: int) -> _HeldOut:
    found = refine(guess, seen[seen.view != view])
    return _HeldOut(found, view, tag_errors(found, seen[seen.view == view]))


def _jackknife(guess: Guess, without: Sequence[Guess]) -> NDArray[np.float64]:
    """Return the covariance of the camera's pose (Efron, "The jackknife", 1982)."""
    moved = np.array([moved_by(guess.camera, other.camera) for other in without])
    moved = moved - moved.mean(axis=0)
    covariance = (len(moved) - 1) / len(moved) * moved.T @ moved
    return (covariance + covariance.T) / 2


def _board_error(
    held_out: _HeldOut, board: Board, view: View, arrangement: Arrangement, intrinsics: Intrinsics, seen: Sightings
) -> tuple[float, float]:
    """Return how far the board in a view is from where it is expected [mm, degrees], by the tags that are right."""
    right = np.isin(view.detections.ids, seen.ids[seen.view == held_out.view])
    return board_offset(
        held_out.guess, board, replace(view, detections=view.detections[right]), arrangement, intrinsics
    )


def _check_lens(guess: Guess, seen: Sightings) -> tuple[float, tuple[float, float], tuple[str, ...]]:
    """Return what another lens would explain better: focal lengths, principal point, and alarms."""
    free = refine(replace(guess, lens=np.zeros(3)), seen)
    assert free.lens is not None, "it was given"
    sigma = np.sqrt(np.diag(clustered_covariance(free, seen))[12:])
    focal, centre = float(free.lens[0]), (float(free.lens[1]), float(free.lens[2]))
    alarms: list[str] = []
    if abs(focal) > max(FOCAL_OFF, SURE * sigma[0]):
        alarms.append(
            f"focal lengths that are {abs(focal):.1%} {'longer' if focal > 0 else 'shorter'} explain the pictures "
            f"better (standard deviation {sigma[0]:.2%}). Calibrate the intrinsics, and measure a tag: its size has "
            "the same effect"
        )
    if np.hypot(*centre) > CENTRE_OFF and any(
        abs(value) > SURE * one for value, one in zip(centre, sigma[1:], strict=True)
    ):
        alarms.append(
            f"a principal point that is ({centre[0]:+.1f}, {centre[1]:+.1f}) px off explains the pictures better; "
            "calibrate the intrinsics"
        )
    return focal, centre, tuple(alarms)


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
