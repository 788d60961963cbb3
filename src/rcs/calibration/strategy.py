"""Strategies of calibration: which images are taken, where the robot goes for them, and what follows from them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import board_poses, project
from rcs.calibration.closed_form import board_in_anchor, middle_pose, rigid
from rcs.calibration.detection import detect, grey
from rcs.calibration.fit import Guess, Sightings, jacobian, refine
from rcs.calibration.hand_eye import HandEye, hand_eye
from rcs.calibration.intrinsics import IntrinsicsFit, fit_intrinsics
from rcs.calibration.motion import motions
from rcs.calibration.rig import Rig, View
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, distort, inverse, tquat_to_matrix

IsFree = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]
"""Whether the arm may go straight from joints to joints [rad]."""

SCALES = (0.1, 0.25, 0.5, 0.9)
"""Standard deviations of the joints' changes that are tried [rad]."""
DRAWN = 800
"""Joints drawn per scale."""
COMPARED = 48
"""Poses with the board in view that are compared."""
FROM_LIMITS = 0.08
"""Least distance from joint limits [rad]."""
BORDER = 0.04
"""Share of the picture's height that the board keeps from its border."""
STEEPEST = np.deg2rad(60.0)
"""Largest angle between the board's normal and the line of sight [rad]: tags are found, and well, up to it."""
SMALLEST = 20.0
"""Least edge of a tag [px]."""
NOISE = 0.3
"""Standard deviation of a corner with the errors of the robot [px]."""
UNSURE = (0.03, 0.1)
"""Uncertainty that is assumed before the first view: standard deviations of a pose [m, rad]."""


def suggest(
    rig: Rig,
    board: Board,
    guess: Guess,
    seen: Sightings,
    joints: Sequence[NDArray[np.float64]],
    *,
    rng: np.random.Generator,
    is_free: IsFree | None = None,
) -> NDArray[np.float64] | None:
    """Return the joints to go to, or None if none of those drawn will do.

    Joints are drawn around those from which the board was seen, inside the limits and such that the whole board is in
    view, large enough and not too slanted. The best of them is the one with which the known determinant of the
    information about both poses grows most (D-optimal design; Fedorov, "Theory of Optimal Experiments", 1972).

    Args:
        rig: The rig that is calibrated.
        board: The board.
        guess: Where camera and board are, as far as is known.
        seen: The sightings so far.
        joints: Where to look around [rad]; the last are the present ones.
        rng: Random numbers.
        is_free: Whether the arm may go there from the present joints; None for anywhere.
    """
    drawn = _draw(rig, joints, rng)
    flanges = rig.kinematics.forward_batch(drawn)
    anchors = tquat_to_matrix(inverse(flanges) if rig.arrangement == "eye-in-hand" else flanges)
    in_view = np.flatnonzero(is_in_view(guess.boards_in_camera(anchors), board, rig.intrinsics))
    chosen = rng.permutation(in_view)[:COMPARED]
    if not len(chosen):
        return None
    known = _information(guess, seen) if len(seen) else np.zeros((12, 12))
    known += np.diag(np.tile([UNSURE[0] ** -2.0] * 3 + [UNSURE[1] ** -2.0] * 3, 2))
    gains = [float(np.linalg.slogdet(known + one)[1]) for one in _informations(guess, board, anchors[chosen], rig)]
    for i in np.argsort(gains)[::-1]:
        if is_free is None or is_free(joints[-1], drawn[chosen[i]]):
            return drawn[chosen[i]]
    return None


def is_in_view(boards_in_camera: NDArray[np.float64], board: Board, intrinsics: Intrinsics) -> NDArray[np.bool_]:
    """Return from which poses a whole board is seen, large enough and not too slanted, (n,).

    Args:
        boards_in_camera: Poses of the board in the optical frame, (n, 4, 4).
        board: The board.
        intrinsics: Intrinsics of the picture.
    """
    corners = board.corners.reshape(-1, 3)
    depths = boards_in_camera[:, 2, :3] @ corners.T + boards_in_camera[:, 2, 3:]
    is_before = depths.min(axis=-1) > 0.02
    rays = project(boards_in_camera, corners)
    # Far out of the picture, the lens model has no meaning, and may fold back into it.
    is_near = (np.abs(rays) < 4.0).all(axis=(-2, -1))
    pixels = distort(np.clip(rays, -4.0, 4.0), intrinsics.distortion) * (intrinsics.fx, intrinsics.fy)
    pixels = pixels + (intrinsics.cx, intrinsics.cy)
    border = BORDER * intrinsics.height
    high = np.array([intrinsics.width, intrinsics.height]) - 1 - border
    is_inside = ((pixels > border) & (pixels < high)).all(axis=(-2, -1))
    tags = pixels.reshape(len(pixels), -1, 4, 2)
    edges = np.linalg.norm(tags - np.roll(tags, 1, axis=-2), axis=-1).min(axis=(-2, -1))
    middle = boards_in_camera[:, :3, 3]
    sight = -middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    facing = np.einsum("ni,ni->n", sight, boards_in_camera[:, :3, 2]) > np.cos(STEEPEST)
    return is_before & is_near & is_inside & (edges > SMALLEST) & facing


def _draw(rig: Rig, joints: Sequence[NDArray[np.float64]], rng: np.random.Generator) -> NDArray[np.float64]:
    low, high = rig.kinematics.joint_lower + FROM_LIMITS, rig.kinematics.joint_upper - FROM_LIMITS
    centres = np.array(joints)[rng.integers(len(joints), size=(len(SCALES), DRAWN))]
    spread = np.array(SCALES)[:, None, None] * rng.standard_normal((len(SCALES), DRAWN, len(low)))
    drawn = (centres + spread).reshape(-1, len(low))
    return np.ascontiguousarray(drawn[((drawn >= low) & (drawn <= high)).all(axis=-1)])


def _informations(guess: Guess, board: Board, anchors: NDArray[np.float64], rig: Rig) -> list[NDArray[np.float64]]:
    """Return the information that a view from every pose would add, (12, 12) each."""
    count, tags = len(anchors), len(board.ids)
    expected = Sightings(
        np.repeat(np.arange(count), tags),
        np.tile(board.ids, count),
        np.repeat(anchors, tags, axis=0),
        np.tile(board.corners, (count, 1, 1)),
        np.zeros((count * tags, 4, 2)),
        (rig.intrinsics.fx, rig.intrinsics.fy),
        rig.arrangement,
    )
    slopes = jacobian(replace(guess, given=None), expected).reshape(count, -1, 12) / NOISE
    return [one.T @ one for one in slopes]


def _information(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    slopes = jacobian(replace(guess, given=None), seen) / NOISE
    return slopes.T @ slopes


ENOUGH = 5
"""Views from which the guess of the camera's pose is made better."""
TRIES = 3
"""Images per wanted view, after which it gives up."""


class CalibrationStrategy(ABC):
    """Finds the pose of a camera, in a way that suits a setup.

    A driver, such as `rcs.rollout.look_around`, brings the arm to rest, calls `look` with an image and `next_joints`
    for the next pose, until there is none; then it calls `solve`. A strategy moves nothing and knows no device.
    """

    @abstractmethod
    def look(self, picture: NDArray[np.uint8], joints: NDArray[np.float64]) -> bool:
        """Look at a picture that was taken at rest, and return whether it is of use.

        Args:
            picture: Colours, (H, W, 3).
            joints: Where the arm was then [rad], (dof,).
        """

    @abstractmethod
    def next_joints(self, joints: NDArray[np.float64], is_free: IsFree | None = None) -> NDArray[np.float64] | None:
        """Return where the arm is to go for the next picture [rad], (dof,); None if no more are needed.

        Args:
            joints: Where it is [rad], (dof,).
            is_free: Whether it may go straight from joints to joints; None for anywhere.

        Raises:
            InvalidSetup: It knows of nowhere to go; the message says what a person is to do.
        """

    @abstractmethod
    def solve(self) -> HandEye:
        """Return where the camera is.

        Raises:
            InvalidSetup: The pictures do not suffice; the message says what is missing.
        """

    def about(self) -> dict[str, Any]:
        """Return how far it is, for people: names and values."""
        return {}


class BoardStrategy(CalibrationStrategy):
    """Goes where a board of AprilTags is in view and the next image is most informative, until there are enough."""

    def __init__(self, rig: Rig, board: Board, *, views: int = 20, seed: int = 0) -> None:
        """Begin without a view.

        Args:
            rig: The arm and the camera to calibrate.
            board: The board.
            views: Number of views to take.
            seed: Seed of the poses that are tried.
        """
        self.rig = rig
        self.board = board
        self.wanted = views
        self.views: list[View] = []
        """Views of the board."""
        self.pictures: list[NDArray[np.uint8]] = []
        """The picture of each view, grey, (H, W)."""
        self._boards: list[NDArray[np.float64]] = []
        self.joints: list[NDArray[np.float64]] = []
        """Joints of the arm for each view [rad]."""
        self._looked = 0
        self._rng = np.random.default_rng(seed)

    def look(self, picture: NDArray[np.uint8], joints: NDArray[np.float64]) -> bool:
        """Look for the board in a picture."""
        self._looked += 1
        found = detect(self.board, picture, self.rig.intrinsics)
        if not len(found):
            return False
        self.pictures.append(grey(picture).copy())
        self.views.append(View(flange_in_base=self.rig.kinematics.forward(joints), detections=found))
        self._boards.append(board_poses(self.board, found, self.rig.intrinsics)[0].board_in_camera)
        self.joints.append(np.array(joints, np.float64))
        return True

    def next_joints(self, joints: NDArray[np.float64], is_free: IsFree | None = None) -> NDArray[np.float64] | None:
        """Return the best joints among many that are tried."""
        if len(self.views) >= self.wanted:
            return None
        if self._looked >= TRIES * self.wanted:
            raise InvalidSetup(
                f"The board was seen in {len(self.views)} of {self._looked} pictures; wanted are {self.wanted}. Is it "
                "lit well, flat, whole in view and at rest?"
            )
        guess = self.guess()
        if guess is None:
            raise InvalidSetup(
                "The board is not in view, and its place is unknown. Move the arm until the camera sees the whole "
                "board, or give its approximate pose."
            )
        seen = Sightings.of(self.board, self.views, self.rig.arrangement, self.rig.intrinsics)
        around = [*self.joints, np.array(joints, np.float64)]
        found = suggest(self.rig, self.board, guess, seen, around, rng=self._rng, is_free=is_free)
        if found is None:
            raise InvalidSetup(
                "No pose was found from which the whole board is in view and to which the arm can go freely. Move the "
                "board to the middle of where the arm works, or take a smaller one."
            )
        return found

    def guess(self) -> Guess | None:
        """Return the present estimate of both poses; None if the board was never seen."""
        if not self.views:
            near = self.rig.board_in_anchor
            return None if near is None else Guess(self.rig.camera_in_mount, near)
        camera = self.rig.camera_in_mount
        anchors = np.array([view.anchor_in_mount(self.rig.arrangement) for view in self.views])
        boards = board_in_anchor(camera.matrix, anchors, np.array(self._boards))
        guess = Guess(camera, rigid(middle_pose(boards)))
        if len(self.views) < ENOUGH:
            return guess
        seen = Sightings.of(self.board, self.views, self.rig.arrangement, self.rig.intrinsics)
        return refine(guess, seen)

    def solve(self) -> HandEye:
        """Return the pose of the camera."""
        return hand_eye(self.board, self.views, self.rig.arrangement, self.rig.intrinsics)

    def intrinsics(self) -> IntrinsicsFit:
        """Return the intrinsics of the camera, from the same images.

        Raises:
            InvalidSetup: The images are not enough; the message says what is missing.
        """
        size = self.rig.intrinsics.width, self.rig.intrinsics.height
        rough = fit_intrinsics(self.board, [view.detections for view in self.views], size).intrinsics
        return fit_intrinsics(self.board, [view.detections for view in self.views_through(rough)], size)

    def views_through(self, lens: Intrinsics) -> list[View]:
        """Return the views with the tags as found in the same images with another lens.

        Args:
            lens: Intrinsics of the camera.
        """
        return [
            replace(view, detections=detect(self.board, picture, lens))
            for view, picture in zip(self.views, self.pictures, strict=True)
        ]

    def about(self) -> dict[str, Any]:
        """Return the number of views, and the largest turn of the arm."""
        turn = motions([view.flange_in_base for view in self.views]).largest_turn
        return {"views": len(self.views), "wanted": self.wanted, "largest turn [degrees]": float(np.rad2deg(turn))}
