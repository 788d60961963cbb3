"""`rcs calibrate intrinsics`, `hand-eye` and `check`: how a camera sees, where it is, and whether it still is there."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data.cli.console import plain_console
from rcs_data.files.output import require_writable

import rcs
from rcs.calibration import BoardStrategy, CalibrationStrategy, Detections, detect, fit_intrinsics, hand_eye, verify
from rcs.cli.calibrate.board import BoardOptions
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.robots.camera import Calibration
from rcs.rollout.calibrate import FreePath, Tour, look_around
from rcs.rollout.person import read_line
from rcs.setups.board_setup import ShowBoardOptions, board_setup
from rcs.setups.calibration import KnownBoard, read_calibration, write_calibration
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp")
"""Endings of files that are pictures."""


@dataclass(kw_only=True)
class SessionOptions:
    """Options of a command that drives a robot from pose to pose and looks at a board."""

    tags: Annotated[BoardOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=BoardOptions)
    robot: str = "fr3"
    """Name of the robot, or of the lab with several."""
    camera: str = "wrist"
    """Name of the camera. One on a gripper looks at a board that lies still; one that stands still looks at a board
    that the gripper holds."""
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors. Without it, all
    is simulated."""
    image_size: tuple[int, int] | None = None
    """Width and height of the pictures [px]; those of the camera's calibration by default."""
    views: int = 20
    """Pictures with the board to take."""
    speed: float = 0.5
    """Largest speed of a joint on hardware [rad/s]."""
    yes: bool = False
    """Do not ask before motions: somebody watches the arms."""
    seed: int = 0
    """Random seed of the poses that are tried."""

    def setup(self, *, at: KnownBoard | None = None, calibration: str | None = None) -> Setup:
        """Return the setup with the board.

        Args:
            at: A board and its place; None for one of these options where a lab would have it.
            calibration: File that says where cameras are.
        """
        setup = board_setup(
            self.robot, self.camera, self.tags.board, at=at, calibration=calibration, image_size=self.image_size
        )
        return setup if self.hardware is None else replace(setup, stepping="realtime")

    @contextmanager
    def session(self, setup: Setup) -> Generator[tuple[MountedCamera, Intrinsics, Callable[[BoardStrategy], None]]]:
        """Open robot and camera, and close them at the end.

        Returns:
            How the camera is mounted, its own intrinsics, and a function that shows a strategy the pictures it wants.
        """
        with ExitStack() as open_ones:
            env = open_ones.enter_context(rcs.make(setup, hardware=self.hardware))
            twin = env
            if self.hardware is not None:
                twin = open_ones.enter_context(rcs.make(replace(setup, stepping="sync")))
            holder = ShowBoardOptions.from_json(setup.task_options).on_gripper_of
            mounted = MountedCamera.of(setup, self.camera, holder)
            robot = mounted.robot.name
            tour = Tour(env, robot=robot, speed=self.speed)
            lens = tour.intrinsics(self.camera)
            if twin is not env:  # the other arms are in the way where they are, which need not be at home
                twin.reset(options={"robot": tour.all_joints})
            is_free, confirm = FreePath(twin, robot), None if self.hardware is None or self.yes else _ask

            def look(strategy: BoardStrategy) -> None:
                look_around(
                    env,
                    strategy,
                    self.camera,
                    robot=robot,
                    speed=self.speed,
                    is_free=is_free,
                    confirm=confirm,
                    on_look=_print_progress,
                )

            yield mounted, lens, look

    def strategy(self, mounted: MountedCamera, setup: Setup, lens: Intrinsics) -> BoardStrategy:
        """Return a strategy for a camera with a lens, which looks at the board of the setup."""
        options = ShowBoardOptions.from_json(setup.task_options)
        rig = mounted.rig(lens, options.mount.pose)
        return BoardStrategy(rig, options.board, views=self.views, seed=self.seed)


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
        pose = _known(self.out, self.camera).optical
        write_calibration(self.out, {self.camera: Calibration(optical=pose, intrinsics=fit.intrinsics)})
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
            known = _known(self.out, self.camera).intrinsics
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


def _known(file: Path, camera: str) -> Calibration:
    """Return what a calibration file says of a camera; nothing if the file or the camera is not there yet."""
    known = read_calibration(file).cameras.get(camera) if file.exists() else None
    return known or Calibration()


def _print_progress(strategy: CalibrationStrategy, is_of_use: bool) -> None:
    values = ", ".join(
        f"{name} {value:.0f}" if isinstance(value, float) else f"{name} {value}"
        for name, value in strategy.about().items()
    )
    plain_console().print(values if is_of_use else f"nothing seen here; {values}")


def _ask(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    turns = ", ".join(f"{turn:+.0f}" for turn in np.rad2deg(end - start))
    question = f"Next pose: joints turn by {turns} degrees. Is the way free? [y]es, [n]ext: "
    return read_line(question).strip().lower() in ("y", "yes")
