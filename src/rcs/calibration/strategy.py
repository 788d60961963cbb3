"""Strategies of calibration: which images are taken, where the robot goes for them, and what follows from them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import board_poses
from rcs.calibration.closed_form import board_in_anchor, middle_pose, rigid
from rcs.calibration.detection import detect, grey
from rcs.calibration.fit import Guess, Sightings, refine
from rcs.calibration.hand_eye import HandEye, hand_eye
from rcs.calibration.intrinsics import IntrinsicsFit, fit_intrinsics
from rcs.calibration.motion import motions
from rcs.calibration.rig import Rig, View
from rcs.calibration.suggestion import IsFree, suggest
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics

ENOUGH = 5
"""Views from which the guess of the camera's pose is made better."""
TRIES = 3
"""Images per wanted view, after which it gives up."""


class CalibrationStrategy(ABC):
    """Finds the pose of a camera, in a way that suits a setup.

    A driver, such as `rcs.rollout.calibrate`, brings the arm to rest, calls `look` with an image and `next_joints` for
    the next pose, until there is none; then it calls `solve`. A strategy moves nothing and knows no device.
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
            InvalidSetup: The pictures cannot tell; the message says what is missing.
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
