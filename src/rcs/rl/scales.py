"""Offsets and scales of a key's numbers: its bounds where they are those of the device, else what really occurs.

Bounds of velocities, forces and poses are far wider than what occurs: divided by them, all would be nearly 0. Nothing
is clipped: a number that is larger than usual is larger than 1 in the vector.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs import spaces as keys
from rcs.envs.env import Env
from rcs.envs.start import base_in_scene
from rcs.envs.task import Area
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.rl.layout import Path
from rcs.setups.make import resolve
from rcs.sim.scene import RobotPlacement
from rcs.spatial import compose, inverse

SPEED = 2.5
"""Joint speed that is 1 where the arm is not known [rad/s]: the largest of relative actions."""
TCP_SPEED, TURN_SPEED = 0.5, 1.8
"""Speeds of objects that are 1 where the arm is not known [m/s, rad/s]: those of `ArmDescription`."""
FORCE, MOMENT = 30.0, 5.0
"""Force and moment on the tool that are 1 [N, Nm]. Our choice: the weight of a payload of 3 kg, and a sixth of that."""
NEAR = 0.1
"""Offset from pose to pose that is 1 [m]. Our choice: about the width of an opened gripper."""
CLOSE = 0.03
"""Offset that is 0.7 in what tells of the last centimetres [m]. Our choice: about half the width of a cuboid."""
CENTRE, AROUND = (0.5, 0.0, 0.0), 0.5
"""Middle and half width of the space of poses where the arm is not known [m]."""


@dataclass(frozen=True)
class Scale:
    """Offset and scale of every number of a key; `(value - offset) / scale` goes into the vector."""

    offset: NDArray[np.float64]
    scale: NDArray[np.float64]
    source: str


@dataclass(frozen=True, kw_only=True)
class Workplace:
    """What scales depend on."""

    robots: Mapping[str, RobotPlacement] = field(default_factory=dict[str, RobotPlacement])
    """Robots by name; none where they are not known."""
    area: Area | None = None
    """Where the task takes place; None where that is not known."""

    def robot(self, path: Path) -> RobotPlacement | None:
        """Return the robot that a key is of."""
        if len(self.robots) == 1:
            return next(iter(self.robots.values()))
        return self.robots.get(path[0])

    def around(self, path: Path) -> Scale:
        """Return the scale of positions (3,): around the middle of the task's area, in the frame of the key."""
        robots = list(self.robots.values())
        if not robots:
            return Scale(np.array(CENTRE), np.full(3, AROUND), "our choice, the arm is not known")
        own = self.robot(path)
        reach = (own or robots[0]).arm.workspace_reach
        if self.area is None:
            return Scale(np.array([0.6 * reach, 0.0, 0.0]), np.full(3, 0.5 * reach), "the arm's reach")
        centre = np.array([*self.area.center, 0.0, 0.0, 0.0, 0.0, 1.0])
        base = base_in_scene(robots) if own is None else base_in_scene([own])
        half = max(0.5 * float(np.hypot(*self.area.size)), 0.25 * reach)
        source = "half the diagonal of the task's area, or a quarter of the arm's reach"
        middle = np.round(compose(inverse(base), centre)[:3], 9) + 0.0  # no rounding of a turned base, no -0
        return Scale(middle, np.full(3, half), source)


def scale_of(path: Path, box: spaces.Box, workplace: Workplace) -> Scale:
    """Return offset and scale of an observed key; of poses, those of the translation come first."""
    size = int(np.prod(box.shape, dtype=int))
    robot = workplace.robot(path)
    arm = None if robot is None else robot.arm
    match path[-1]:
        case keys.TQUAT:
            around = workplace.around(path)
            return Scale(np.append(around.offset, np.zeros(4)), np.append(around.scale, np.ones(4)), around.source)
        case keys.XYZRPY:
            around = workplace.around(path)
            scale = np.append(around.scale, np.full(3, np.pi))
            return Scale(np.append(around.offset, np.zeros(3)), scale, f"{around.source}; a half turn")
        case keys.JOINT_VELOCITIES:
            source = "our choice, the arm is not known" if arm is None else "the arm's velocity limits"
            return _about_zero(SPEED if arm is None else arm.velocity_limit, size, source)
        case keys.VELOCITY:
            any_arm = arm or next((one.arm for one in workplace.robots.values()), None)
            speeds = (TCP_SPEED, TURN_SPEED) if any_arm is None else (any_arm.tcp_speed, any_arm.tcp_turn_speed)
            return _about_zero(np.repeat(speeds, 3), size, "largest speeds of the TCP in relative control")
        case keys.TCP_WRENCH:
            return _about_zero(np.repeat([FORCE, MOMENT], 3), size, "our choice: the weight of a payload of 3 kg")
        case _:
            return bounds_of(box)


def bounds_of(box: spaces.Box) -> Scale:
    """Return offset and scale that map finite bounds to -1 and 1; numbers without bounds stay as they are."""
    low, high = box.low.astype(np.float64).ravel(), box.high.astype(np.float64).ravel()
    is_bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(is_bounded, low, -1.0), np.where(is_bounded, high, 1.0)
    half = 0.5 * (high - low)
    source = "its bounds" if is_bounded.all() else "its bounds; 1 where there are none"
    return Scale(0.5 * (high + low), np.where(half > 0, half, 1.0), source)


def workplace_of(env: Any) -> Workplace:
    """Return what scales depend on, of an `Env` or `VecEnv`, also under gymnasium's wrappers.

    Raises:
        InvalidSetup: It is none.
    """
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, Env | VecEnv):
        raise InvalidSetup(f"{env!r} is no environment of rcs; make the maps with Flat.from_spaces.")
    area: Area | None = None
    if isinstance(inner, VecEnv) or inner.is_simulated:
        area = inner.scenario.task.area
    elif inner.has_setup:
        area = resolve(inner.setup).task.area
    return Workplace(robots=inner.robots, area=area)


def _about_zero(scale: ArrayLike, size: int, source: str) -> Scale:
    return Scale(np.zeros(size), np.broadcast_to(np.array(scale, np.float64), (size,)).copy(), source)
