"""The interface of a calibration strategy: what is looked at, where the robot goes for it, and what follows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.hand_eye import HandEye
from rcs.calibration.suggestion import IsFree


class CalibrationStrategy(ABC):
    """Finds out where a camera is, in a way that suits a setup.

    A driver, such as `rcs.rollout.calibrate`, brings the arm to rest, has the strategy look at a picture, asks it where
    to go next, and so on until it wants no more; then it has it solve. A strategy moves nothing and knows no device.
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
