"""`rcs plan`: a motion of a robot past obstacles, as numbers and as a video or a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray
from rcs_data.cli.console import plain_console
from rcs_data.convert.png import encode_png
from rcs_data.output import require_writable

from rcs.cli.runs import pose_of
from rcs.cli.setup_options import SetupOptions
from rcs.envs.env import Env
from rcs.envs.planner_for import ScenePlanner, planner_for
from rcs.errors import InvalidSetup
from rcs.planning.path import TimedPath
from rcs.rollout.video import Video
from rcs.setups.make import make
from rcs.sim.viewer import Picture

RATE = 30.0
"""Pictures per second of a video."""
STRIP = 4
"""Pictures side by side in a picture."""


@dataclass(kw_only=True)
class PlanCommand(SetupOptions):
    """Plan a motion of a robot past what is in the scene of a task, and draw it.

    It begins where the robot starts the episode, or at `--start`, and ends at joints, `--goal`, or at a pose of the
    TCP, `--pose`. Nothing is simulated: what is drawn is the planned motion.
    """

    goal: tuple[float, ...] | None = None
    """Joints of the goal [rad], one for each joint."""
    pose: tuple[float, float, float, float, float, float] | None = None
    """TCP pose of the goal in the base frame: x y z [m], roll pitch yaw [rad]."""
    start: tuple[float, ...] | None = None
    """Joints of the start [rad]; by default where the robot is."""
    planner: str = "RRTConnect"
    """RRT, RRTConnect, RRTstar, FMT, BITstar, or another geometric planner of OMPL; EST needs no extra."""
    margin: float = 0.005
    """Distance to keep from everything [m]."""
    speed: float = 1.0
    """Share of the robot's speed, up to 1."""
    time_limit: float = 5.0
    """Longest search [s]."""
    arm: str | None = None
    """Name of the robot to move, where there are several."""
    out: FilePath = FilePath("plan.mp4")
    """A video (.mp4), or a picture of four moments (.png)."""

    def run(self) -> int:
        """Plan, print figures and draw."""
        if (self.goal is None) == (self.pose is None):
            raise InvalidSetup("Give where to go: either --goal with joints, or --pose with x y z roll pitch yaw.")
        goal = np.array(self.goal) if self.pose is None else pose_of(self.pose)
        if self.out.suffix not in (".mp4", ".png"):
            raise InvalidSetup(f"out is {str(self.out)!r}; valid are files that end in .mp4 or .png.")
        require_writable(self.out, is_file=True)
        console = plain_console()
        with make(self.setup()) as env:
            env.reset(seed=self.seed)
            planner = planner_for(
                env, self.arm, speed=self.speed, planner=self.planner, margin=self.margin, time_limit=self.time_limit
            )
            begin = time.perf_counter()
            path = planner.plan(planner.joints if self.start is None else self.start, goal, seed=self.seed)
            took = time.perf_counter() - begin
            timed = planner.time(path)
            console.print(
                f"{self.planner}: {len(path.waypoints)} waypoints, {path.length:.2f} rad, in {1e3 * took:.0f} ms; "
                f"takes {timed.duration:.2f} s"
            )
            for row in path.waypoints:
                console.print("  " + " ".join(f"{value:8.4f}" for value in row))
            self._draw(env, planner, timed)
        console.print(f"{self.out} shows it.")
        return 0

    def _draw(self, env: Env, planner: ScenePlanner, timed: TimedPath) -> None:
        picture = Picture(env.simulation.world)

        def at(joints: NDArray[np.float64]) -> NDArray[np.uint8]:
            planner.put(joints)
            return picture.draw()

        try:
            if self.out.suffix == ".mp4":
                video = Video(self.out, rate=RATE)
                try:
                    for joints in timed.sampled(RATE).positions:
                        video.add(at(joints))
                finally:
                    video.close()
                return
            moments = timed.at(np.linspace(0.0, timed.duration, STRIP)).positions
            self.out.parent.mkdir(parents=True, exist_ok=True)
            self.out.write_bytes(encode_png(np.hstack([at(joints) for joints in moments])))
        finally:
            picture.close()
