"""Chooses what of an environment's spaces goes into flat vectors, and how."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from rcs.envs import spaces as keys
from rcs.errors import InvalidSetup
from rcs.rl.layout import LARGEST, Entry, FlatLayout, Image, Kind, Path
from rcs.rl.scales import NEAR, Scale, Workplace, bounds_of, scale_of

Feature = Literal["offset", "relative_turn"]
"""What is told of pairs of poses beside the poses: TCP to object, object to object."""

FEATURES: tuple[Feature, ...] = ("offset", "relative_turn")

DEPTH_LEVEL_MM = 8
"""Depth of one level of a depth image [mm]: 255 levels reach 2 m, which is beyond a table."""


def layout_of(
    action_space: spaces.Space[Any],
    observation_space: spaces.Space[Any],
    workplace: Workplace,
    *,
    wanted: Sequence[str] | None = None,
    features: Sequence[str] = FEATURES,
    cameras: Sequence[str] | None = None,
) -> FlatLayout:
    """Return the layout of an environment's vectors.

    Args:
        action_space: Of one copy.
        observation_space: Of one copy.
        workplace: Robots and area.
        wanted: Keys of the state, such as `joints`, `privileged/cuboid` or `left`; a key with others inside means all
            of these. None for all but `xyzrpy`, which says the same as `tquat`.
        features: What is told of pairs of poses.
        cameras: Names of the cameras whose frames are observed; None for all.

    Raises:
        InvalidSetup: A space is not one of numbers, a key or a camera is unknown, or nothing is left.
    """
    action_boxes = _boxes(action_space, "action")
    found = _boxes(observation_space, "observation")
    frames = {path: box for path, box in found.items() if path[0] == keys.FRAMES}
    state = _wanted({path: box for path, box in found.items() if path not in frames}, wanted)
    if unknown := sorted(set(features) - set(FEATURES)):
        raise InvalidSetup(f"features has {unknown}; valid: {', '.join(map(repr, FEATURES))}.")
    names = list(workplace.robots)
    bases: dict[str, tuple[float, ...]] = {}
    if len(names) > 1:
        mounts = {name: robot.base_in_scene for name, robot in workplace.robots.items()}
        bases = {name: (*map(float, (*one.translation, *one.quaternion)),) for name, one in mounts.items()}
    images = _images(frames, cameras)
    layout = FlatLayout(
        action=tuple(_placed(_action_entries(action_boxes))),
        state=tuple(_placed(_state_entries(state, workplace, features))),
        images=images,
        bases=bases,
    )
    if not layout.action:
        raise InvalidSetup("The environment takes no action that could be a vector.")
    if not layout.state and not layout.images:
        raise InvalidSetup(f"Nothing is left to observe; keys with numbers: {_names(found)}.")
    return layout


def _boxes(space: spaces.Space[Any], what: str, path: Path = ()) -> dict[Path, spaces.Box]:
    """Return the boxes in nested dictionaries by path."""
    if isinstance(space, spaces.Dict):
        inner = [_boxes(value, what, (*path, str(key))) for key, value in space.spaces.items()]
        return {key: box for one in inner for key, box in one.items()}
    if not isinstance(space, spaces.Box):
        name = "/".join(path) or what
        raise InvalidSetup(f"The {what} {name!r} has the space {space}; a vector takes Box spaces alone.")
    return {path: space}


def _wanted(found: Mapping[Path, spaces.Box], wanted: Sequence[str] | None) -> dict[Path, spaces.Box]:
    if wanted is None:
        return {path: box for path, box in found.items() if not _is_told_twice(path, found)}
    if isinstance(wanted, str):
        raise InvalidSetup(f"keys is the text {wanted!r}; give a sequence, such as [{wanted!r}].")
    chosen: dict[Path, spaces.Box] = {}
    for name in wanted:
        start = tuple(name.split("/"))
        inside = {path: box for path, box in found.items() if path[: len(start)] == start}
        if not inside:
            raise InvalidSetup(f"There is no key {name!r} of numbers in the observation; valid: {_names(found)}.")
        chosen |= {path: box for path, box in inside.items() if path == start or not _is_told_twice(path, inside)}
    return chosen


def _is_told_twice(path: Path, found: Iterable[Path]) -> bool:
    return path[-1] == keys.XYZRPY and (*path[:-1], keys.TQUAT) in found


def _names(found: Iterable[Path]) -> str:
    return ", ".join("/".join(path) for path in found if path[0] != keys.FRAMES) or "none"


# --- Entries, still without their places ------------------------------------------------------------------------------


def _action_entries(boxes: Mapping[Path, spaces.Box]) -> Iterator[Entry]:
    for path, box in boxes.items():
        if not box.is_bounded():
            raise InvalidSetup(f"The action {'/'.join(path)!r} has no finite bounds to be mapped to -1 and 1.")
        size = int(np.prod(box.shape, dtype=int))
        yield _entry(path, box, bounds_of(box), slice(0, size), bounds=(-np.ones(size), np.ones(size)))


def _state_entries(boxes: Mapping[Path, spaces.Box], workplace: Workplace, features: Sequence[str]) -> Iterator[Entry]:
    poses: dict[Path, Entry] = {}
    for path, box in boxes.items():
        scale = scale_of(path, box, workplace)
        if path[-1] == keys.TQUAT and box.shape == (7,):
            poses[path] = _entry(path, box, scale, slice(0, 3))
            yield poses[path]
            yield _turn(path, box, "turn")
        else:
            yield _entry(path, box, scale, slice(0, len(scale.offset)))
    for here, there in _pairs(list(poses), workplace):
        first, second = poses[here], poses[there]
        far = np.array([_reach(one) for one in zip(first.low, first.high, first.offset, first.scale, strict=True)])
        far = far + [_reach(one) for one in zip(second.low, second.high, second.offset, second.scale, strict=True)]
        near = NEAR * (1.0 if workplace.area is None else workplace.area.object_scale)
        if "offset" in features:
            scale = Scale(np.zeros(3), np.full(3, near), "our choice: about the width of an opened gripper")
            bounds = (-far / near, far / near)
            yield _entry(here, boxes[here], scale, slice(0, 3), kind="offset", to=there, bounds=bounds, unit="m")
        if "relative_turn" in features:
            yield _turn(here, boxes[here], "relative_turn", there)


def _pairs(poses: Sequence[Path], workplace: Workplace) -> Iterator[tuple[Path, Path]]:
    """Return which poses are told relative to which: every TCP to every object, and objects in turn."""
    objects = [path for path in poses if path[0] == keys.PRIVILEGED]
    tcps = [path for path in poses if path[0] != keys.PRIVILEGED]
    if not workplace.robots and len(tcps) > 1:
        return  # where their bases stand is not known
    yield from ((tcp, other) for tcp in tcps for other in objects)
    yield from pairwise(objects)


def _reach(bounds: tuple[float, float, float, float]) -> float:
    """Return how far a number is from 0 at most, in the key's unit."""
    low, high, offset, scale = bounds
    return max(abs(offset + scale * low), abs(offset + scale * high))


def _turn(path: Path, box: spaces.Box, kind: Kind, to: Path = ()) -> Entry:
    scale = Scale(np.zeros(6), np.ones(6), "a rotation matrix")
    return _entry(path, box, scale, slice(0, 6), kind=kind, to=to, bounds=(-np.ones(6), np.ones(6)), unit="1")


def _entry(
    path: Path,
    box: spaces.Box,
    scale: Scale,
    picked: slice,
    *,
    kind: Kind = "value",
    to: Path = (),
    bounds: Any = None,
    unit: str | None = None,
) -> Entry:
    offset, by = scale.offset[picked], scale.scale[picked]
    if bounds is None:
        own = (box.low.astype(np.float64).ravel()[picked], box.high.astype(np.float64).ravel()[picked])
        bounds = [np.clip((bound - offset) / by, -LARGEST, LARGEST) for bound in own]
    return Entry(
        path=path,
        kind=kind,
        to=to,
        place=(0, len(by)),
        picked=(picked.start, picked.stop) if kind == "value" else (0, 0),
        shape=tuple(map(int, box.shape)),
        dtype=np.dtype(box.dtype or np.float64).name,
        offset=tuple(offset.tolist()),
        scale=tuple(by.tolist()),
        low=tuple(np.asarray(bounds[0]).tolist()),
        high=tuple(np.asarray(bounds[1]).tolist()),
        unit=keys.UNITS.get(path[-1], "1") if unit is None else unit,
        source=scale.source,
    )


def _placed(entries: Iterable[Entry]) -> Iterator[Entry]:
    end = 0
    for entry in entries:
        first, end = end, end + len(entry.scale)
        yield replace(entry, place=(first, end))


def _images(frames: Mapping[Path, spaces.Box], cameras: Sequence[str] | None) -> tuple[Image, ...]:
    known = list(dict.fromkeys(path[1] for path in frames))
    wanted = known if cameras is None else list(cameras)
    if unknown := [name for name in wanted if name not in known]:
        raise InvalidSetup(f"There are no cameras {unknown}; valid: {', '.join(map(repr, known)) or 'none'}.")
    found: list[Image] = []
    for path, box in frames.items():
        if path[1] not in wanted or path[-1] not in (keys.RGB, keys.DEPTH):
            continue
        if path[-1] == keys.RGB:
            height, width, channels = box.shape
            found.append(Image(path=path, name=path[1], shape=(channels, height, width)))
        else:
            height, width = box.shape
            found.append(
                Image(
                    path=path, name=f"{path[1]}_depth", shape=(1, height, width), is_depth=True, level_mm=DEPTH_LEVEL_MM
                )
            )
    return tuple(found)
