"""`rcs calibrate hand-eye`: where a camera is."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rcs_data.cli.console import plain_console
from rcs_data.files.output import require_writable

from rcs.calibration import hand_eye
from rcs.cli.calibrate.session import SessionOptions
from rcs.setups.calibration import read_calibration, write_calibration
from rcs.spatial import Intrinsics


@dataclass(kw_only=True)
class HandEyeCommand(SessionOptions):
    """Find where a camera is, on a gripper or beside the robot, by looking at a board from many poses.

    The arm goes by itself from pose to pose, to those from which the next picture adds most; on hardware a person
    confirms each first. The camera's pose, its covariance and the place of the board are written to the calibration
    file, which `calibration="…"` of an environment takes; if it says already how the camera sees, that is used. Exit
    code 1, and nothing is written, if something is amiss.
    """

    intrinsics: bool = False
    """Find how the camera sees from the same pictures, too."""
    accept: bool = False
    """Write the result even if something is amiss."""
    out: Path = field(default_factory=lambda: Path("calibration.json"))
    """Calibration file; what it has of other cameras stays."""

    def run(self) -> int:
        """Calibrate, print how well, and write."""
        require_writable(self.out, is_file=True)
        console = plain_console()
        setup = self.setup()
        with self.session(setup) as (mounted, own_lens, look):
            known = self._known_lens()
            lens = own_lens if known is None else known.cut(setup.cameras.size_of(self.camera))
            strategy = self.strategy(mounted, setup, lens)
            look(strategy)
            views = strategy.views
            if self.intrinsics:
                fit = strategy.intrinsics()
                console.print(str(fit))
                lens = fit.intrinsics
                views = strategy.views_through(lens)
            found = hand_eye(strategy.board, views, strategy.rig.arrangement, lens)
            console.print(str(found))
            if found.alarms and not self.accept:
                console.print("Nothing was written; --accept writes it all the same.")
                return 1
            write_calibration(
                self.out,
                {self.camera: mounted.calibration(found, lens if self.intrinsics or known is None else known)},
                {self.camera: mounted.known_board(found, strategy.board)},
            )
        console.print(f"{self.out}: camera {self.camera!r}, and the board that it looked at")
        return 0

    def _known_lens(self) -> Intrinsics | None:
        """Return how the camera sees if the file says it already, as `rcs calibrate intrinsics` has found it."""
        known = read_calibration(self.out).cameras.get(self.camera) if self.out.exists() else None
        return None if known is None else known.intrinsics
