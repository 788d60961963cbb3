"""Calibration of a camera: drives a robot from pose to pose, and shows a strategy what the camera sees at rest."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration import CalibrationStrategy, IsFree
from rcs.envs.env import Env
from rcs.envs.planner_for import planner_for
from rcs.envs.spaces import DISTORTION, FRAMES, INTRINSICS, JOINTS, RGB, Observation, join_robots, split_by_robot
from rcs.errors import InvalidSetup, WrongOrder
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Intrinsics

Confirm = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]
"""Asks the user whether the arm may move from joints to joints [rad]."""

OnLook = Callable[[CalibrationStrategy, bool], None]
"""Called after every picture, with whether it is useful."""

ARRIVED = 3e-3
"""Largest distance of a joint from its target at arrival [rad]."""
STILL = 2e-4
"""Largest change of a joint per control step at rest [rad]."""
SETTLING = 0.5
"""Time that a real arm rests before a picture counts: it swings a little longer than its joints turn [s]."""
LONGEST = 30.0
"""Time limit of a motion, beside the time that its way takes at the largest speed [s]."""
MARGIN = 0.01
"""Least distance of the robot's shapes from all others [m]."""
STEP, TURN = 0.002, 0.01
"""Largest motion of any point and largest rotation between two checks near obstacles [m, rad]."""
ROUNDING = 1e-5
"""Largest decrease of the distance to obstacles near the start [m]."""
LOOKS = 20
"""Points of a path that starts near an obstacle at which to check whether it is still near."""


def look_around(
    env: Env,
    strategy: CalibrationStrategy,
    camera: str,
    *,
    robot: str | None = None,
    speed: float = 0.5,
    is_free: IsFree | None = None,
    confirm: Confirm | None = None,
    on_look: OnLook | None = None,
) -> None:
    """Show a strategy pictures from the joints that it proposes, until it needs no more; then it can solve.

    Args:
        env: An environment with absolute joint targets that observes the camera; it is reset.
        strategy: Judges pictures and proposes joints.
        camera: Name of the camera.
        robot: Name of the robot that moves; None for the one that carries the camera, or for the first.
        speed: Largest speed of a joint in real time [rad/s].
        is_free: Returns whether the arm may go straight from joints to joints; None for anywhere within its limits.
        confirm: Called before every motion; if it returns False, the strategy proposes the next best pose. None to move
            without confirmation.
        on_look: Called after every picture, with whether it is useful.

    Raises:
        InvalidSetup: The environment has other actions, or pictures or free joints do not suffice.
        WrongOrder: The arm does not arrive, or the episode ends.
    """
    tour = Tour(env, robot=robot or MountedCamera.of(env.setup, camera).robot.name, speed=speed)

    def may_go(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        is_way_free = tour.is_within_limits(end) and (is_free is None or is_free(start, end))
        return is_way_free and (confirm is None or confirm(start, end))

    while True:
        is_of_use = strategy.look(tour.picture(camera), tour.joints)
        if on_look is not None:
            on_look(strategy, is_of_use)
        joints = strategy.next_joints(tour.joints, may_go)
        if joints is None:
            return
        tour.go_to(joints)


class Tour:
    """Moves one arm of an environment from joints to joints, at a bounded speed, and looks at rest."""

    def __init__(self, env: Env, *, robot: str | None = None, speed: float = 0.5) -> None:
        """Reset the environment.

        Args:
            env: An environment with absolute joint targets.
            robot: Name of the robot, if there are several.
            speed: Largest speed of a joint [rad/s].

        Raises:
            InvalidSetup: It has other actions, there is no such robot, or the speed is not above 0.
        """
        if not speed > 0:
            raise InvalidSetup(f"speed is {speed!r} rad/s; valid is a number above 0.")
        if env.setup.control != "joints" or env.setup.relative != "absolute":
            raise InvalidSetup(
                f"Calibration drives with absolute joint targets; this environment has control={env.setup.control!r}, "
                f"relative={env.setup.relative!r}. Use control='joints', relative='absolute'."
            )
        names = list(env.robots)
        if robot is not None and robot not in names:
            raise InvalidSetup(f"There is no robot named {robot!r}; this environment has {names}.")
        self._env = env
        self._robot = robot or names[0]
        self._speed = speed
        self._observation: Observation
        self._info: dict[str, Any]
        self._observation, self._info = env.reset()

    @property
    def joints(self) -> NDArray[np.float64]:
        """Present joints of the arm [rad], (dof,)."""
        return np.array(self._own[JOINTS], np.float64)

    @property
    def all_joints(self) -> dict[str, Any]:
        """Present joints of all arms, as the reset option `robot` has them."""
        parts = split_by_robot(self._env.robots, self._observation)
        return join_robots({name: {JOINTS: np.array(part[JOINTS], np.float64)} for name, part in parts.items()})

    @property
    def _own(self) -> dict[str, Any]:
        return split_by_robot(self._env.robots, self._observation)[self._robot]

    def is_within_limits(self, joints: NDArray[np.float64]) -> bool:
        """Return whether joints [rad], (dof,), are within the limits in force, which may be narrower than the arm's."""
        return bool((self._bounded(joints) == joints).all())

    def frame(self, camera: str) -> dict[str, NDArray[Any]]:
        """Return the last frame of a camera.

        Raises:
            InvalidSetup: It is not observed.
        """
        frames = self._observation.get(FRAMES, {})
        if camera not in frames:
            raise InvalidSetup(f"Camera {camera!r} is not observed; give cameras=({camera!r},) to the environment.")
        return frames[camera]

    def picture(self, camera: str) -> NDArray[np.uint8]:
        """Return the last picture of a camera, (H, W, 3)."""
        return self.frame(camera)[RGB]

    def intrinsics(self, camera: str) -> Intrinsics:
        """Return the known intrinsics of a camera.

        Raises:
            InvalidSetup: It is not observed, or its intrinsics are unknown.
        """
        frame = self.frame(camera)
        if INTRINSICS not in frame:
            raise InvalidSetup(f"The intrinsics of camera {camera!r} are unknown; calibrate them first.")
        height, width = frame[RGB].shape[:2]
        return Intrinsics.of_matrix(frame[INTRINSICS], (width, height), frame.get(DISTORTION, ()))

    def go_to(self, joints: NDArray[np.float64]) -> None:
        """Move the arm and wait until it has arrived and is at rest, and the cameras have new pictures.

        Args:
            joints: Target [rad], (dof,).

        Raises:
            WrongOrder: It does not arrive, or the episode ends.
        """
        target = self.joints
        stride = self._speed / self._env.frequency if self._env.is_real else np.inf
        off, since = np.inf, None
        limit = LONGEST + (float(np.abs(joints - target).max()) / self._speed if self._env.is_real else 0.0)
        for _ in range(int(limit * self._env.frequency)):
            way = joints - target
            target = target + way * min(1.0, stride / max(float(np.abs(way).max()), 1e-12))
            before = self.joints
            self._step(target)
            off, moved = float(np.abs(self.joints - joints).max()), float(np.abs(self.joints - before).max())
            if off >= ARRIVED or moved >= STILL:
                since = None
            elif since is None:
                since = self._time
            elif self._has_new_frames(since):
                return
        raise WrongOrder(
            f"Robot {self._robot!r} did not arrive within {limit:.3g} s: it is {np.rad2deg(off):.1f} degrees off. "
            "Is something in its way?"
        )

    @property
    def _time(self) -> float:
        """Now [s], on the clock of the frames' ages."""
        return time.perf_counter() if self._env.is_real else float(self._info["time"])

    def _has_new_frames(self, since: float) -> bool:
        """Return whether all frames were taken when the arm had been at rest for long enough."""
        rest = self._time - since - (SETTLING if self._env.is_real else 0.0)
        ages: dict[str, Any] = self._info.get("ages", {})
        return rest > 0 and all(float(age) < rest for key, age in ages.items() if key.startswith(FRAMES))

    def _step(self, target: NDArray[np.float64]) -> None:
        spaces = split_by_robot(self._env.robots, self._env.action_space)
        actions = {
            name: {key: np.array(part[key]) for key in spaces[name]}  # where they are
            for name, part in split_by_robot(self._env.robots, self._observation).items()
        }
        actions[self._robot][JOINTS] = self._bounded(target)  # it may have come to rest a little beyond a limit
        self._observation, _, terminated, truncated, self._info = self._env.step(join_robots(actions))
        if terminated or truncated:
            why = f"{self._info.get('end')} {self._info.get('faults', '')}".rstrip()
            raise WrongOrder(f"The episode ended on the way: {why}")

    def _bounded(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        space: Any = split_by_robot(self._env.robots, self._env.action_space)[self._robot][JOINTS]
        return np.clip(joints, space.low, space.high)


class FreePath:
    """Checks paths of one arm; everything else stays where it is at the time.

    The shapes are those that collide in the scene. A path that starts near something may lead away from it, but no
    nearer; from where nothing is near any more, it keeps the margin.
    """

    def __init__(self, env: Env, robot: str) -> None:
        """Use the scene of an environment.

        Args:
            env: A simulated environment of one copy.
            robot: Name of the robot.
        """
        self._planner = planner_for(env, robot)

    def __call__(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether the arm may go straight from joints to joints [rad], (dof,) each."""
        self._planner.look()
        checker = self._planner.checker
        nearest = checker.clearance(start, MARGIN).distance
        if nearest >= MARGIN:
            return checker.first_hit(start, end, STEP, TURN, MARGIN) is None
        ways = start + np.linspace(0.0, 1.0, LOOKS + 1)[1:, None] * (end - start)
        away = ways[checker.free_rows(ways, MARGIN)]
        left = away[0] if len(away) else end
        return (
            checker.first_hit(start, left, STEP, TURN, nearest - ROUNDING) is None
            and checker.first_hit(left, end, STEP, TURN, MARGIN if len(away) else nearest - ROUNDING) is None
        )
