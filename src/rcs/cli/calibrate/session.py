"""What the commands of `rcs calibrate` that look through a camera share."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rcs_data.cli.console import plain_console
from rich.console import Console

import rcs
from rcs.calibration import BoardStrategy, CalibrationStrategy, IsFree
from rcs.cli.calibrate.board import BoardOptions
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.rollout.calibrate import Confirm, Tour, look_around
from rcs.rollout.free_path import FreePath
from rcs.setups.board_setup import board_setup
from rcs.setups.calibration import KnownBoard
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics
from rcs.tasks.show_board import ShowBoard, ShowBoardOptions


@dataclass(kw_only=True)
class SessionOptions(BoardOptions):
    """Options of a command that drives a robot from pose to pose and looks at a board."""

    robot: str = "fr3"
    """Name of the robot, or of the lab with several."""
    camera: str = "wrist"
    """Name of the camera. One on a gripper looks at a board that lies still; one that stands still looks at a board
    that the gripper holds."""
    hardware: Path | None = None
    """File of the site whose robot and camera are used; without one, all is simulated."""
    image_size: tuple[int, int] | None = None
    """Width and height of the pictures [px]; those of the camera's calibration by default."""
    views: int = 20
    """Pictures with the board to take."""
    speed: float = 0.5
    """Largest speed of a joint on hardware [rad/s]."""
    yes: bool = False
    """Do not ask before each motion of real hardware."""
    seed: int = 0
    """Of the poses that are tried."""

    def setup(self, *, at: KnownBoard | None = None, calibration: str | None = None) -> Setup:
        """Return the setup with the board.

        Args:
            at: A board and its place; None for one of these options where a lab would have it.
            calibration: File that says where cameras are.
        """
        setup = board_setup(
            self.robot, self.camera, self.board, at=at, calibration=calibration, image_size=self.image_size
        )
        return setup if self.hardware is None else replace(setup, stepping="realtime")

    @contextmanager
    def session(self, setup: Setup, console: Console) -> Generator[Session]:
        """Open robot and camera, and close them at the end."""
        with ExitStack() as open_ones:
            env = open_ones.enter_context(rcs.make(setup, hardware=self.hardware))
            twin = env
            if self.hardware is not None:
                twin = open_ones.enter_context(rcs.make(replace(setup, stepping="sync")))
                twin.reset()
            mounted = MountedCamera.of(setup, self.camera)
            tour = Tour(env, robot=mounted.robot.name, speed=self.speed)
            yield Session(
                env=env,
                mounted=mounted,
                intrinsics=tour.intrinsics(self.camera),
                is_free=FreePath(twin, mounted.robot.name),
                confirm=None if self.hardware is None or self.yes else _ask,
                console=console,
                speed=self.speed,
            )

    def strategy(self, session: Session, setup: Setup, lens: Intrinsics | None = None) -> BoardStrategy:
        """Return the strategy of a session.

        Args:
            session: The session.
            setup: Its setup.
            lens: How the camera sees; None for as it says itself.
        """
        options = ShowBoard.parse_options(setup.task_options)
        assert isinstance(options, ShowBoardOptions), "they are the task's"
        rig = session.mounted.rig(lens or session.intrinsics, options.pose)
        return BoardStrategy(rig, options.board, views=self.views, seed=self.seed)


@dataclass(frozen=True, kw_only=True)
class Session:
    """A robot and a camera that are open."""

    env: Env
    """They."""
    mounted: MountedCamera
    """How the camera is mounted."""
    intrinsics: Intrinsics
    """How it is said to see."""
    is_free: IsFree
    """Whether the arm may go somewhere."""
    confirm: Confirm | None
    """Asks a person, on hardware."""
    console: Console
    """Where to tell."""
    speed: float
    """Largest speed of a joint on hardware [rad/s]."""

    def look_around(self, strategy: CalibrationStrategy) -> None:
        """Show a strategy the pictures that it wants."""
        look_around(
            self.env,
            strategy,
            self.mounted.camera.name,
            robot=self.mounted.robot.name,
            speed=self.speed,
            is_free=self.is_free,
            confirm=self.confirm,
            on_look=self._tell,
        )

    def _tell(self, strategy: CalibrationStrategy, is_of_use: bool) -> None:
        """Print how far a strategy is."""
        values = ", ".join(
            f"{name} {value:.0f}" if isinstance(value, float) else f"{name} {value}"
            for name, value in strategy.about().items()
        )
        self.console.print(values if is_of_use else f"nothing seen here; {values}")


def _ask(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    console = plain_console()
    turns = ", ".join(f"{turn:+.0f}" for turn in np.rad2deg(end - start))
    return console.input(f"Next pose: joints turn by {turns} degrees. Is the way free? [y]es, [n]ext: ").lower() == "y"
