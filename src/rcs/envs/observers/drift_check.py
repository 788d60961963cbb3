"""Checks, while an environment runs, that a camera still is where its calibration puts it.

A thread looks for tags, so that no step waits. While it works on a picture, the newest one waits, and those in between
are counted as missed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration import Board, detect
from rcs.calibration.verify import Drift, reprojection_errors
from rcs.envs.observer import Observer, Transition
from rcs.envs.spaces import DISTORTION, EXTRINSICS, FRAMES, INTRINSICS, RGB, Observation
from rcs.spatial import Intrinsics
from rcs.worker import Worker

BoardPlace = Callable[[Observation], NDArray[np.float64]]
"""Returns the pose of a board, (4, 4), in the frame of the cameras' `extrinsics`."""

_log = logging.getLogger(__name__)


class DriftCheck(Observer):
    """Compares the place at which a board is seen with the expected one, and warns once when they drift apart.

    `drift.pixels` is the present error. With `note`, it is given to `env.note` as `drift_px` at every step that follows
    a picture with tags; a recorder that is made with `notes=("drift_px",)` keeps it.
    """

    def __init__(
        self,
        camera: str,
        board: Board,
        place: BoardPlace,
        *,
        drift: Drift | None = None,
        note: Callable[..., None] | None = None,
        on_alarm: Callable[[float], None] | None = None,
    ) -> None:
        """Look at nothing yet; the thread starts with the first picture.

        Args:
            camera: Name of the camera, whose frames have `extrinsics`.
            board: The board.
            place: Returns its pose.
            drift: Judges the errors; None for one with usual limits.
            note: `env.note`, to have the error recorded.
            on_alarm: Called once, in the thread of this observer, with the error [px].
        """
        self.camera = camera
        self.drift = drift or Drift()
        self.pictures = 0
        """Number of pictures that were looked at."""
        self.missed = 0
        """Number of pictures that were left out because the one before took too long."""
        self.has_alarmed = False
        """Whether the drift has exceeded its limit at some time."""
        self._board = board
        self._place = place
        self._note = note
        self._on_alarm = on_alarm
        self._last: Any = None
        self._worker = Worker(f"drift check of {camera}", self._look)

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Look at the first picture."""
        self.on_step(first)

    def on_step(self, transition: Transition) -> None:
        """Hand a new picture to the thread."""
        frame = transition.observation.get(FRAMES, {}).get(self.camera, {})
        if self._note is not None and np.isfinite(self.drift.pixels):
            self._note(drift_px=self.drift.pixels)
        if EXTRINSICS not in frame or INTRINSICS not in frame or frame[RGB] is self._last:
            return
        self._last = frame[RGB]
        if self._worker.error is not None:
            raise self._worker.error
        with self._worker.changed:
            self.missed += len(self._worker.waiting)
            self._worker.waiting.clear()
            self._worker.put(transition.observation)

    def wait(self) -> None:
        """Wait until all pictures that were handed over have been looked at."""
        self._worker.wait()

    def close(self) -> None:
        """Look at the last picture and end the thread. Closing twice is harmless."""
        self._worker.wait()
        self._worker.close()

    def _look(self, observation: Observation) -> None:
        frame = observation[FRAMES][self.camera]
        height, width = frame[RGB].shape[:2]
        intrinsics = Intrinsics.of_matrix(frame[INTRINSICS], (width, height), frame.get(DISTORTION, ()))
        expected = np.linalg.inv(frame[EXTRINSICS]) @ self._place(observation)
        found = detect(self._board, frame[RGB], intrinsics)
        self.pictures += 1
        self.drift.add(reprojection_errors(self._board, expected, found, intrinsics))
        if self.drift.is_off and not self.has_alarmed:
            self.has_alarmed = True
            _log.warning(
                "Camera %r sees the board %.1f px from where its calibration expects it, above %.1f px: camera or "
                "board moved, so calibrate anew.",
                self.camera,
                self.drift.pixels,
                self.drift.limit_px,
            )
            if self._on_alarm is not None:
                self._on_alarm(self.drift.pixels)
