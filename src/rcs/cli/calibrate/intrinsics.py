"""`rcs calibrate intrinsics`: how a camera sees."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rcs_data.cli.console import plain_console
from rcs_data.files.output import require_writable

from rcs.calibration import Detections, IntrinsicsFit, detect, fit_intrinsics
from rcs.cli.calibrate.session import SessionOptions
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.robots.camera import Calibration
from rcs.setups.calibration import read_calibration, write_calibration
from rcs.spatial import Intrinsics

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp")
"""Endings of files that are pictures."""


@dataclass(kw_only=True)
class IntrinsicsCommand(SessionOptions):
    """Find how a camera sees: focal lengths, principal point and distortion.

    From pictures of a board in a folder, or from pictures that it takes by itself with the robot, as `hand-eye` does.
    In the calibration file, the camera's pose stays as it is; without one, the lab's is used.
    """

    pictures: Path | None = None
    """Folder with pictures of the board, all of one size, from different sides and all over the picture."""
    out: Path = field(default_factory=lambda: Path("calibration.json"))
    """Calibration file; what it has of other cameras stays."""

    def run(self) -> int:
        """Fit, print how well, and write."""
        require_writable(self.out, is_file=True)
        console = plain_console()
        if self.pictures is not None:
            rough = fit_intrinsics(self.tags.board, *self._read(self.pictures)).intrinsics
            fit = fit_intrinsics(self.tags.board, *self._read(self.pictures, rough))
        else:
            setup = self.setup()
            with self.session(setup) as (mounted, lens, look):
                strategy = self.strategy(mounted, setup, lens)
                look(strategy)
                fit = strategy.intrinsics()
        console.print(str(fit))
        self._write(fit)
        console.print(f"{self.out}: how camera {self.camera!r} sees")
        return 0

    def _read(self, folder: Path, lens: Intrinsics | None = None) -> tuple[list[Detections], tuple[int, int]]:
        files = sorted(path for path in folder.glob("*") if path.suffix.lower() in ENDINGS)
        if not files:
            raise InvalidSetup(f"{folder} has no pictures; valid endings: {', '.join(ENDINGS)}.")
        cv2 = package_of("calibration", "cv2")
        found: list[Detections] = []
        sizes: set[tuple[int, int]] = set()
        for file in files:
            picture = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
            if picture is None:
                raise InvalidSetup(f"{file} is not a picture that can be read.")
            sizes.add((picture.shape[1], picture.shape[0]))
            found.append(detect(self.tags.board, picture, lens))
        if len(sizes) > 1:
            raise InvalidSetup(f"The pictures in {folder} have several sizes, {sorted(sizes)}; give those of one mode.")
        return found, sizes.pop()

    def _write(self, fit: IntrinsicsFit) -> None:
        before = read_calibration(self.out).cameras.get(self.camera) if self.out.exists() else None
        pose = None if before is None else before.optical
        write_calibration(self.out, {self.camera: Calibration(optical=pose, intrinsics=fit.intrinsics)})
