"""The layout of an environment's vectors: which numbers they have, in which order, and how they are scaled."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs import spaces as keys
from rcs.errors import InvalidSetup
from rcs.rl.layout import LARGEST, Entry, FlatLayout, Image, Kind, Path
from rcs.rl.scales import CLOSE, NEAR, Scale, Workplace, bounds_of, scale_of
from rcs.rl.selection import Feature, Selection

DEPTH_LEVEL_MM = 8
"""Depth of one level of a depth image [mm]: 255 levels reach 2 m, which is beyond a table."""

_PART = re.compile(r"(?P<key>[^\[\]]+)(?:\[(?P<first>\d+)(?::(?P<end>\d+))?\])?")


def layout_of(
    action_space: spaces.Space[Any],
    observation_space: spaces.Space[Any],
    workplace: Workplace,
    selection: Selection,
) -> FlatLayout:
    """Return the layout of an environment's vectors.

    Args:
        action_space: Of one copy.
        observation_space: Of one copy.
        workplace: Robots and area.
        selection: What goes into the vectors.

    Raises:
        InvalidSetup: A space is not one of numbers, a key or a camera is unknown, or nothing is left.
    """
    found = _boxes(observation_space, "observation")
    frames = {path: box for path, box in found.items() if path[0] == keys.FRAMES}
    state = _wanted({path: box for path, box in found.items() if path not in frames}, selection.keys)
    bases: dict[str, tuple[float, ...]] = {}
    if len(workplace.robots) > 1:
        mounts = {name: robot.base_in_scene for name, robot in workplace.robots.items()}
        bases = {name: (*map(float, (*one.translation, *one.quaternion)),) for name, one in mounts.items()}
    layout = FlatLayout(
        action=tuple(_placed(_action_entries(_boxes(action_space, "action"), selection.actions))),
        state=tuple(_placed(_state_entries(state, workplace, selection.features))),
        images=_images(frames, selection.cameras),
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


def _action_entries(boxes: Mapping[Path, spaces.Box], wanted: Sequence[str] | None) -> Iterator[Entry]:
    parts = (
        [("/".join(path), path, None) for path in boxes] if wanted is None else [_part(one, boxes) for one in wanted]
    )
    if missing := [path for path in boxes if path not in [path for _, path, _ in parts]]:
        raise InvalidSetup(f"actions has nothing of {_names(missing)}; select at least one number of every key.")
    taken: set[tuple[Path, int]] = set()
    for name, path, picked in parts:
        box = boxes[path]
        if not box.is_bounded():
            raise InvalidSetup(f"The action {'/'.join(path)!r} has no finite bounds to be mapped to -1 and 1.")
        size = int(np.prod(box.shape, dtype=int))
        picked = picked or slice(0, size)
        if not 0 <= picked.start < picked.stop <= size:
            raise InvalidSetup(f"actions has {name!r}; the key has the numbers 0 to {size - 1}.")
        numbers = {(path, i) for i in range(picked.start, picked.stop)}
        if numbers & taken:
            raise InvalidSetup(f"actions has {name!r}, numbers of which it has before; select each once.")
        taken |= numbers
        scale, count = bounds_of(box), picked.stop - picked.start
        entry = _entry(path, box, scale, picked, bounds=(-np.ones(count), np.ones(count)))
        yield entry if count == size else replace(entry, rest=tuple(scale.offset.tolist()))


def _part(text: str, boxes: Mapping[Path, spaces.Box]) -> tuple[str, Path, slice | None]:
    """Return the key and the numbers that a text such as `xyzrpy[0:3]` selects."""
    match = _PART.fullmatch(text)
    path = tuple(match["key"].split("/")) if match else ()
    if match is None or path not in boxes:
        raise InvalidSetup(
            f"actions has {text!r}; valid are {_names(boxes)}, or numbers of them, such as 'joints[0:3]'."
        )
    if match["first"] is None:
        return text, path, None
    first = int(match["first"])
    return text, path, slice(first, first + 1 if match["end"] is None else int(match["end"]))


def _state_entries(
    boxes: Mapping[Path, spaces.Box], workplace: Workplace, features: Sequence[Feature]
) -> Iterator[Entry]:
    poses: dict[Path, Entry] = {}
    for path, box in boxes.items():
        scale = scale_of(path, box, workplace)
        if path[-1] == keys.TQUAT and box.shape == (7,):
            poses[path] = _entry(path, box, scale, slice(0, 3), unit="m")
            yield poses[path]
        else:
            yield _entry(path, box, scale, slice(0, len(scale.offset)))
    for path in poses:
        yield _turn(path, boxes[path], "turn")
    pairs = list(_pairs(list(poses), workplace))
    for feature in features:
        for here, there in pairs:
            if feature == "relative_turn":
                yield _turn(here, boxes[here], feature, there)
            elif feature == "half_turn":
                if here[0] != keys.PRIVILEGED:
                    yield _turn(here, boxes[here], feature, there, size=2)
            else:
                yield _way(here, boxes[here], feature, poses[here], poses[there], workplace)


def _pairs(poses: Sequence[Path], workplace: Workplace) -> Iterator[tuple[Path, Path]]:
    """Return which poses are told relative to which: TCPs and targets to every object, and an object to the next."""
    objects = [path for path in poses if path[0] == keys.PRIVILEGED]
    tcps = [path for path in poses if path[0] != keys.PRIVILEGED]
    if not workplace.robots and len(tcps) > 1:
        return  # where their bases stand is not known
    yield from ((tcp, other) for tcp in tcps for other in objects)
    yield from pairwise(objects)


def _way(path: Path, box: spaces.Box, kind: Kind, here: Entry, there: Entry, workplace: Workplace) -> Entry:
    """Return the entry of the way from a pose to another."""
    is_near = kind == "near"
    length = (CLOSE if is_near else NEAR) * (1.0 if workplace.area is None else workplace.area.object_scale)
    source = "our choice: " + ("the last centimetres of a grasp" if is_near else "about the width of an opened gripper")
    far = np.ones(3) if is_near else (_farthest(here) + _farthest(there) + _apart(here, there, workplace)) / length
    scale = Scale(np.zeros(3), np.full(3, length), source)
    return _entry(path, box, scale, slice(0, 3), kind=kind, to=there.path, bounds=(-far, far), unit="m")


def _farthest(entry: Entry) -> NDArray[np.float64]:
    """Return how far a position is from the frame's origin at most, along any axis [m]."""
    ends = [np.array(entry.offset) + np.array(entry.scale) * np.array(bound) for bound in (entry.low, entry.high)]
    return np.full(3, float(np.linalg.norm(np.abs(ends).max(axis=0))))


def _apart(here: Entry, there: Entry, workplace: Workplace) -> float:
    """Return how far the frames of two positions are apart at most [m]: of several robots, bases from the scene."""
    if len(workplace.robots) < 2:
        return 0.0
    mounts = [workplace.robots[one.path[0]] for one in (here, there) if one.path[0] in workplace.robots]
    return float(sum(np.linalg.norm(one.base_in_scene.translation) for one in mounts))


def _turn(path: Path, box: spaces.Box, kind: Kind, to: Path = (), size: int = 6) -> Entry:
    source = "of a rotation matrix" if size == 6 else "cosine and sine"
    scale = Scale(np.zeros(size), np.ones(size), source)
    bounds = (-np.ones(size), np.ones(size))
    return _entry(path, box, scale, slice(0, size), kind=kind, to=to, bounds=bounds, unit="")


def _entry(
    path: Path,
    box: spaces.Box,
    scale: Scale,
    picked: slice,
    *,
    kind: Kind = "value",
    to: Path = (),
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    unit: str | None = None,
) -> Entry:
    offset, by = scale.offset[picked], scale.scale[picked]
    if bounds is None:
        low, high = (bound.astype(np.float64).ravel()[picked] for bound in (box.low, box.high))
        bounds = (np.clip((low - offset) / by, -LARGEST, LARGEST), np.clip((high - offset) / by, -LARGEST, LARGEST))
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
        low=tuple(bounds[0].tolist()),
        high=tuple(bounds[1].tolist()),
        unit=keys.UNITS.get(path[-1], "") if unit is None else unit,
        source=scale.source,
    )


def _placed(entries: Iterable[Entry]) -> Iterator[Entry]:
    end = 0
    for entry in entries:
        first, end = end, end + len(entry.scale)
        yield replace(entry, place=(first, end))


def _images(frames: Mapping[Path, spaces.Box], cameras: Sequence[str] | None) -> tuple[Image, ...]:
    known = list(dict.fromkeys(path[1] for path in frames))
    if unknown := [name for name in cameras or () if name not in known]:
        raise InvalidSetup(f"There are no cameras {unknown}; valid: {', '.join(map(repr, known)) or 'none'}.")
    found: list[Image] = []
    for name in known if cameras is None else cameras:
        for path, box in frames.items():
            if path[1] != name:
                continue
            if path[-1] == keys.RGB:
                height, width, channels = box.shape
                found.append(Image(path=path, name=name, shape=(channels, height, width)))
            elif path[-1] == keys.PIXELS:
                channels, height, width = box.shape
                found.append(Image(path=path, name=name, shape=(channels, height, width)))
            elif path[-1] == keys.DEPTH:
                shape = (1, box.shape[0], box.shape[1])
                found.append(
                    Image(path=path, name=f"{name}_depth", shape=shape, is_depth=True, level_mm=DEPTH_LEVEL_MM)
                )
    return tuple(found)
