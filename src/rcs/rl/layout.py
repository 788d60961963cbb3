"""The layout of flat vectors: which keys and which features of poses their numbers are, and how they are scaled.

Every number is `(value - offset) / scale`. Bounds of velocities, forces and poses are far wider than what occurs:
divided by them, all would be nearly 0. They are scaled by what occurs instead, and never clipped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from rcs_data.options import Natural, Positive, Record, Whole

from rcs.envs import spaces as names
from rcs.envs.env import Env
from rcs.envs.start import base_in_scene
from rcs.envs.task import Area
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.setups.make import resolve
from rcs.sim.scene import RobotPlacement
from rcs.spatial import compose, inverse

FORCE, MOMENT = 30.0, 5.0
"""Force and moment on the tool that are 1 [N, Nm]. Our choice: the weight of a payload of 3 kg, and a sixth of that."""
NEAR = 0.1
"""Distance between two poses that is 1 [m]. Our choice: about the width of an opened gripper."""
CLOSE = 0.03
"""Distance that is 0.7 in the feature `near` [m]. Our choice: about half the width of a cuboid."""
Feature = Literal["offset", "near", "relative_turn", "half_turn"]
"""Features of a pair of poses, which follow from the poses but are hard to learn: from each TCP, and from its target
where that is observed, to each object, and from each object to the next.

- `offset`: the vector d from one position to the other, in the axes of the base (of several robots: the scene).
- `near`: the same with more resolution in the last centimetres, along each axis: d / sqrt(d² + scale²), within -1 and
  1.
- `relative_turn`: the rotation of the second pose in the frame of the first, as the first two columns of its matrix.
- `half_turn`: how the second pose's x axis is turned about the z axis of the first, as cosine and sine of twice the
  angle: a gripper fits a box that is turned by half a turn as well.
"""
Kind = Literal["value", "turn", "offset", "near", "relative_turn", "half_turn"]
"""Kind of an entry: `value` for numbers of a key, `turn` for the rotation of a pose as the first two columns of its
matrix, which have no jumps (Zhou et al. 2019, arXiv:1812.07035), or a feature of a pair."""


class Entry(Record):
    """Consecutive numbers of a vector."""

    key: str
    """Key, with slashes between levels, such as `privileged/cuboid/tquat`; for a pair, that of the first pose."""
    kind: Kind = "value"
    """Kind of the numbers."""
    to: str = ""
    """For a pair, the key of the second pose."""
    shape: tuple[Natural, ...] = ()
    """For a value, the shape of the key's array, of which the entry has the first numbers: all, or a pose's
    position."""
    dtype: str = "float64"
    """For a value, the type of the key's array."""
    offset: tuple[float, ...]
    """Values that become 0, in the key's unit."""
    scale: tuple[Positive, ...]
    """Changes of the values that become 1, in the key's unit."""
    unit: str = ""
    """Unit of offset and scale."""

    def __post_init__(self) -> None:
        """Check that there are as many offsets as scales.

        Raises:
            InvalidSetup: There are not.
        """
        super().__post_init__()
        if len(self.offset) != len(self.scale):
            raise InvalidSetup(f"The entry {self.name!r} has {len(self.offset)} offsets and {len(self.scale)} scales.")

    @property
    def size(self) -> int:
        """Count of numbers."""
        return len(self.scale)

    @property
    def name(self) -> str:
        """The key, and for a pair both keys."""
        return f"{self.key} to {self.to}" if self.to else self.key


class Image(Record):
    """A camera's colour frame: uint8, channels before rows before columns."""

    key: str
    """Its key, with slashes between levels."""
    name: str
    """Its name in the flat observation."""
    shape: tuple[Whole, Whole, Whole]
    """Channels, height and width."""


class FlatLayout(Record):
    """The meaning of every number of a flat observation and action, as checkpoints keep it."""

    action: tuple[Entry, ...]
    """Entries of the action's vector."""
    state: tuple[Entry, ...]
    """Entries of the observation's vector."""
    images: tuple[Image, ...] = ()
    """Cameras' frames."""
    bases: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    """For several robots, the poses of their bases in the scene by name, (7,) [m], xyzw."""

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return sum(entry.size for entry in self.action)

    @property
    def state_size(self) -> int:
        """Numbers of an observation."""
        return sum(entry.size for entry in self.state)

    def __str__(self) -> str:
        """Return a line per entry."""
        images = [f"  {'':8}{image.name:66}{'x'.join(map(str, image.shape))} uint8" for image in self.images]
        return "\n".join(["observation", *_lines(self.state), *images, "action", *_lines(self.action)])


def _lines(entries: Iterable[Entry]) -> Iterator[str]:
    first = 0
    for entry in entries:
        end = first + entry.size
        offset, scale = (
            f"{min(numbers):.3g}" if min(numbers) == max(numbers) else f"[{min(numbers):.3g} … {max(numbers):.3g}]"
            for numbers in (entry.offset, entry.scale)
        )
        kind = "" if entry.kind == "value" else f" ({entry.kind.replace('_', ' ')})"
        numbers = f"{first}" if entry.size == 1 else f"{first}-{end - 1}"
        yield f"  {numbers:8}{entry.name + kind:66}(value - {offset}) / {scale} {entry.unit}".rstrip()
        first = end


def layout_of(env: Env | VecEnv, keys: Sequence[str] | None = None) -> FlatLayout:
    """Return the layout of an environment's vectors.

    Args:
        env: The environment, also under Gymnasium's wrappers.
        keys: Observed keys; see `Flat`.

    Raises:
        InvalidSetup: It is no environment of rcs, a space is not one of numbers, a key is unknown, or nothing is left.
    """
    inner: Any = getattr(env, "unwrapped", env)
    if not isinstance(inner, Env | VecEnv):
        raise InvalidSetup(f"{env!r} is no environment of rcs; make it with rcs.make or rcs.make_vec.")
    area = None
    if isinstance(inner, VecEnv) or inner.is_simulated:
        area = inner.simulation.task.area
    elif inner.has_setup:
        area = resolve(inner.setup).task.area
    action = getattr(env, "single_action_space", env.action_space)
    observation = getattr(env, "single_observation_space", env.observation_space)
    return layout_of_spaces(action, observation, Scales(inner.robots, area), keys)


def layout_of_spaces(
    action_space: spaces.Space[Any],
    observation_space: spaces.Space[Any],
    scales: Scales,
    keys: Sequence[str] | None = None,
) -> FlatLayout:
    """Return the layout of vectors of two spaces.

    Args:
        action_space: The space of actions of one copy.
        observation_space: The space of observations of one copy.
        scales: The scales of observed keys.
        keys: Observed keys; see `Flat`.

    Raises:
        InvalidSetup: A space is not one of numbers, a key is unknown, or nothing is left.
    """
    actions, found = _boxes(action_space, "action"), _boxes(observation_space, "observation")
    several = scales.robots if len(scales.robots) > 1 else {}
    frames = {key: box for key, box in found.items() if key.partition("/")[0] == names.FRAMES}
    state = _selected({key: box for key, box in found.items() if key not in frames}, keys)
    if unbounded := [key for key, box in actions.items() if not box.is_bounded()]:
        raise InvalidSetup(f"The action {unbounded[0]!r} has no finite bounds to be mapped to -1 and 1.")
    layout = FlatLayout(
        action=tuple(_value(key, box, *bounds_of(box)) for key, box in actions.items()),
        state=tuple(_state_entries(state, scales)),
        images=tuple(_images(frames)),
        bases={name: tuple(base_in_scene([robot]).tolist()) for name, robot in several.items()},
    )
    if not layout.action:
        raise InvalidSetup("The environment takes no action that could be a vector.")
    if not layout.state and not layout.images:
        raise InvalidSetup(f"Nothing is left to observe; keys with numbers: {_names(found)}.")
    return layout


def _boxes(space: spaces.Space[Any], what: str, prefix: str = "") -> dict[str, spaces.Box]:
    """Return the boxes in nested dictionaries, with slashes between levels."""
    if isinstance(space, spaces.Dict):
        inner = [_boxes(own, what, f"{prefix}/{key}" if prefix else str(key)) for key, own in space.spaces.items()]
        return {key: box for one in inner for key, box in one.items()}
    if not isinstance(space, spaces.Box):
        raise InvalidSetup(f"The {what} {prefix or what!r} has the space {space}; a vector takes Box spaces alone.")
    return {prefix: space}


def _selected(found: Mapping[str, spaces.Box], wanted: Sequence[str] | None) -> dict[str, spaces.Box]:
    if wanted is None:
        return {key: box for key, box in found.items() if not _is_redundant(key, found)}
    chosen: dict[str, spaces.Box] = {}
    for name in wanted:
        inside = {key: box for key, box in found.items() if key == name or key.startswith(f"{name}/")}
        if not inside:
            raise InvalidSetup(f"There is no key {name!r} of numbers in the observation; valid: {_names(found)}.")
        chosen |= {key: box for key, box in inside.items() if key == name or not _is_redundant(key, inside)}
    return chosen


def _is_redundant(key: str, found: Iterable[str]) -> bool:
    """Return whether a key is the pose in roll, pitch and yaw, beside the same with a quaternion."""
    return _last(key) == names.XYZRPY and key.removesuffix(names.XYZRPY) + names.TQUAT in found


def _names(found: Iterable[str]) -> str:
    return ", ".join(key for key in found if key.partition("/")[0] != names.FRAMES) or "none"


def _last(key: str) -> str:
    return key.rpartition("/")[2]


def _images(frames: Mapping[str, spaces.Box]) -> Iterator[Image]:
    for key, box in frames.items():
        _, camera, kind = key.split("/")
        if kind == names.PIXELS:
            channels, rows, columns = box.shape
        elif kind == names.RGB:
            rows, columns, channels = box.shape
        else:
            continue
        yield Image(key=key, name=camera, shape=(channels, rows, columns))


def _state_entries(boxes: Mapping[str, spaces.Box], scales: Scales) -> Iterator[Entry]:
    """Yield the entries of an observation: all values, then the rotations of poses, then features of pairs."""
    poses: list[str] = []
    for key, box in boxes.items():
        offset, scale = scales.of(key, box)
        if _last(key) == names.TQUAT and box.shape == (7,):
            poses.append(key)
            yield _value(key, box, offset[:3], scale[:3], unit="m")
        else:
            yield _value(key, box, offset, scale)
    for key in poses:
        yield _feature(key, "turn", 6)
    objects = [key for key in poses if key.startswith(f"{names.PRIVILEGED}/")]
    tcps = [key for key in poses if key not in objects]
    length = 1.0 if scales.area is None else scales.area.object_scale
    for feature in get_args(Feature):
        for first, second in [*((tcp, other) for tcp in tcps for other in objects), *pairwise(objects)]:
            if feature == "relative_turn":
                yield _feature(first, feature, 6, to=second)
            elif feature != "half_turn":
                scale = (CLOSE if feature == "near" else NEAR) * length
                yield _feature(first, feature, 3, to=second, scale=scale, unit="m")
            elif first in tcps:
                yield _feature(first, feature, 2, to=second)


def _value(key: str, box: spaces.Box, offset: ArrayLike, scale: ArrayLike, unit: str | None = None) -> Entry:
    return Entry(
        key=key,
        shape=tuple(map(int, box.shape)),
        dtype=np.dtype(box.dtype or np.float64).name,
        offset=tuple(np.asarray(offset).tolist()),
        scale=tuple(np.asarray(scale).tolist()),
        unit=names.UNITS.get(_last(key), "") if unit is None else unit,
    )


def _feature(key: str, kind: Kind, size: int, *, to: str = "", scale: float = 1.0, unit: str = "") -> Entry:
    return Entry(key=key, kind=kind, to=to, offset=(0.0,) * size, scale=(scale,) * size, unit=unit)


Scale = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Offset and scale of every number of a key."""


@dataclass(frozen=True)
class Scales:
    """Scales of observed keys, from the robots and the task's area."""

    robots: Mapping[str, RobotPlacement]
    """Robots by name, one or more."""
    area: Area | None
    """The area of the task; None if unknown."""

    def of(self, key: str, box: spaces.Box) -> Scale:
        """Return the scale of a key; the translation of a pose comes first."""
        size = int(np.prod(box.shape, dtype=int))
        robot = self._robot(key)
        arm = (robot or next(iter(self.robots.values()))).arm
        match _last(key):
            case names.TQUAT | names.XYZRPY as kind:
                middle, half = self._around(robot)
                turns = np.full(3, np.pi) if kind == names.XYZRPY else np.ones(4)
                return np.append(middle, np.zeros(len(turns))), np.append(half, turns)
            case names.JOINT_VELOCITIES:
                return np.zeros(size), np.array(np.broadcast_to(arm.velocity_limit, size))
            case names.VELOCITY:
                return np.zeros(size), np.repeat((arm.tcp_speed, arm.tcp_turn_speed), 3)
            case names.TCP_WRENCH:
                return np.zeros(size), np.repeat([FORCE, MOMENT], 3)
            case _:
                return bounds_of(box)

    def _robot(self, key: str) -> RobotPlacement | None:
        """Return the robot that a key is of."""
        return next(iter(self.robots.values())) if len(self.robots) == 1 else self.robots.get(key.partition("/")[0])

    def _around(self, robot: RobotPlacement | None) -> Scale:
        """Return the scale of positions (3,) in a robot's base frame: around the middle of the task's area."""
        robots = list(self.robots.values())
        reach = (robot or robots[0]).arm.workspace_reach
        if self.area is None:
            return np.array([0.6 * reach, 0.0, 0.0]), np.full(3, 0.5 * reach)
        centre = np.array([*self.area.center, 0.0, 0.0, 0.0, 0.0, 1.0])
        base = base_in_scene(robots if robot is None else [robot])
        half = max(0.5 * float(np.hypot(*self.area.size)), 0.25 * reach)
        middle = np.round(compose(inverse(base), centre)[:3], 9) + 0.0  # no rounding of a turned base, no -0
        return middle, np.full(3, half)


def bounds_of(box: spaces.Box) -> Scale:
    """Return the scale that maps finite bounds to -1 and 1; numbers without bounds stay as they are."""
    low, high = box.low.astype(np.float64).ravel(), box.high.astype(np.float64).ravel()
    is_bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(is_bounded, low, -1.0), np.where(is_bounded, high, 1.0)
    half = 0.5 * (high - low)
    return 0.5 * (high + low), np.where(half > 0, half, 1.0)
