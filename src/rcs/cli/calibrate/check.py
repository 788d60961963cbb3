"""`rcs calibrate check`: whether a camera still is where its calibration says."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rcs_data.cli.console import plain_console

from rcs.calibration import BoardStrategy, verify
from rcs.cli.calibrate.board import BoardOptions
from rcs.cli.calibrate.session import SessionOptions
from rcs.errors import InvalidSetup
from rcs.setups.calibration import read_calibration
from rcs.setups.mounted_camera import MountedCamera


@dataclass(kw_only=True)
class CheckCommand(SessionOptions):
    """Look at the board of a calibration file from new poses, and compare with what the file says.

    In simulation, the camera is where the lab has it, and the board where the file has it. Exit code 1 if the
    calibration no longer holds.
    """

    calibration: Path = field(default_factory=lambda: Path("calibration.json"))
    """Calibration file, with the camera and with a board of the same name."""
    views: int = 5
    """Pictures with the board to take."""
    limit_px: float = 2.0
    """Largest distance of corners from where they are expected, as the median [px]."""

    def run(self) -> int:
        """Look, compare, and print the result."""
        console = plain_console()
        boards = read_calibration(self.calibration).boards
        if self.camera not in boards:
            raise InvalidSetup(
                f"{self.calibration} has no board named {self.camera!r} but {sorted(boards)}; `rcs calibrate hand-eye "
                f"--camera {self.camera}` writes one."
            )
        known = boards[self.camera]
        if self.tags != BoardOptions():
            raise InvalidSetup(
                f"{self.calibration} says which board it is ({known.board}); leave the options of a board out."
            )
        setup = self.setup(at=known)
        with self.session(setup) as (_, own_lens, look):
            calibrated = self.setup(at=known, calibration=str(self.calibration))
            said = MountedCamera.of(calibrated, self.camera, known.on_gripper_of)
            seen = said.camera.calibration
            lens = own_lens if seen is None or seen.intrinsics is None else seen.intrinsics
            lens = lens.cut(setup.cameras.size_of(self.camera))
            strategy = BoardStrategy(said.rig(lens, known.mount.pose), known.board, views=self.views, seed=self.seed)
            look(strategy)
        found = verify(strategy.rig, known.board, strategy.views)
        console.print(
            f"board {found.pixels:.2f} px from where it is expected, {found.millimetres:.2f} mm and "
            f"{found.degrees:.3f} degrees; medians of {found.views} views"
        )
        if found.pixels > self.limit_px:
            console.print(f"ALARM: more than {self.limit_px:g} px. Camera or board moved; calibrate anew.")
            return 1
        return 0
