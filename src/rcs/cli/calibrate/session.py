"""Options and steps that the commands of `rcs calibrate` that look through a camera share."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data.cli.console import plain_console

import rcs
from rcs.calibration import BoardStrategy, CalibrationStrategy
from rcs.cli.calibrate.board import BoardOptions
from rcs.envs.setup import Setup
from rcs.rollout.calibrate import FreePath, Tour, look_around
from rcs.rollout.episode import read_line
from rcs.setups.board_setup import ShowBoardOptions, board_setup
from rcs.setups.calibration import KnownBoard
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics


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
