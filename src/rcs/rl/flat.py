"""Dictionaries of an environment as vectors, and back: what learners read and write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidAction, InvalidSetup
from rcs.rl.choice import FEATURES, Feature, layout_of
from rcs.rl.layout import Entry, FlatLayout, Image, Path
from rcs.rl.scales import Workplace, workplace_of
from rcs.spatial import compose, matrix_to_tquat, normalize, relative, tquat_to_matrix

STATE = "state"
"""Key of the vector in a flat observation that has images too."""


class Flat:
    """Maps between dictionaries and vectors, for one environment, many copies, or a policy without any.

    Arrays are indexed from the right: an observation of one copy, (n,) per key, becomes a vector, one of many copies,
    (copies, n), a matrix. The maps remember nothing, and the same numbers give the same bits in a batch of any size.

    Actions: -1 and 1 are the bounds of every number; vectors are clipped to them. Observations: each number is
    `(value - offset) / scale`, about -1 to 1 in what usually occurs, and never clipped, so that the way back is exact;
    `observation_space` has the true bounds. `print(flat.layout)` says what each number is, and why.

    Rotations are told by two columns of their matrix, which has no jumps; back comes the quaternion with w >= 0.
    """

    def __init__(
        self,
        of: Any,
        *,
        keys: Sequence[str] | None = None,
        features: Sequence[Feature] = FEATURES,
        cameras: Sequence[str] | None = None,
    ) -> None:
        """Choose what the vectors have.

        Args:
            of: An `Env` or `VecEnv`, or the layout of another Flat, which is all that the maps need.
            keys: Keys of the state, such as `joints`, `privileged/cuboid` or, of several robots, `left`; a key with
                others inside means all of these. None for all but `xyzrpy`, which says the same as `tquat`.
            features: What is told of pairs of poses, from each TCP to each object and from an object to the next:
                `offset` the way, `relative_turn` the rotation. It follows from the poses, but is hard to learn.
            cameras: Names of the cameras whose frames are observed; None for all.

        Raises:
            InvalidSetup: A space is not one of numbers, a key or a camera is unknown, or nothing is left.
        """
        if not isinstance(of, FlatLayout):
            action = getattr(of, "single_action_space", of.action_space)
            observation = getattr(of, "single_observation_space", of.observation_space)
            of = layout_of(action, observation, workplace_of(of), wanted=keys, features=features, cameras=cameras)
        self.layout: FlatLayout = of
        """What the numbers are."""
        layout = self.layout
        self._action = _Table(layout.action)
        self._state = _Table(layout.state)
        self._bases = {name: np.array(base) for name, base in layout.bases.items()}
        self._plan = _PosePlan(layout.state, self._bases)
        self.action_space = spaces.Box(-1.0, 1.0, (layout.action_size,), np.float32)
        """The space of vectors of one action."""
        self.state_space = spaces.Box(self._state.low, self._state.high, dtype=np.float32)
        """The space of vectors of one observation."""
        self.observation_space: spaces.Box | spaces.Dict = self.state_space
        """The space of one flat observation: the vector, or, with cameras, a dictionary with the vector as `state` and
        a frame (channels, height, width) per camera."""
        if layout.images:
            frames: dict[str, spaces.Space[Any]] = {
                image.name: spaces.Box(0, 255, image.shape, np.uint8) for image in layout.images
            }
            self.observation_space = spaces.Dict(({STATE: self.state_space} if layout.state else {}) | frames)

    @classmethod
    def from_spaces(cls, action_space: spaces.Space[Any], observation_space: spaces.Space[Any]) -> Flat:
        """Make the maps from two spaces of one copy; scales are then general ones, for the robots are not known."""
        return cls(layout_of(action_space, observation_space, Workplace()))

    # --- Actions ------------------------------------------------------------------------------------------------------

    def action(self, vector: ArrayLike) -> dict[str, Any]:
        """Return the action of a vector.

        Args:
            vector: Shape (..., n); what is beyond -1 and 1 counts as -1 and 1.

        Raises:
            InvalidAction: A number is not finite, or the shape is wrong.
        """
        given = np.asarray(vector, np.float64)
        size = self.layout.action_size
        if given.ndim == 0 or given.shape[-1] != size:
            raise InvalidAction(f"The action has shape {given.shape}; valid is (..., {size}).")
        if not np.isfinite(given).all():
            index = tuple(map(int, np.argwhere(~np.isfinite(given))[0]))
            raise InvalidAction(f"The action's number {list(index)} is {given[index]}; valid is -1 to 1.")
        values = np.minimum(np.maximum(given, -1.0), 1.0) * self._action.scale + self._action.offset
        return self._action.nested(values)

    def action_vector(self, action: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the vector of an action, (..., n): the inverse of `action`.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        return self._action.scaled(self._action.gathered(action))

    # --- Observations -------------------------------------------------------------------------------------------------

    def observation(self, observation: Mapping[str, Any]) -> Any:
        """Return the flat observation: a vector (..., n), or, with cameras, a dictionary with it and the frames.

        All arrays are new, but for frames that have channels first already.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        if not self.layout.images:
            return self.state(observation)
        flat = {STATE: self.state(observation)} if self.layout.state else {}
        return flat | {image.name: _picture(observation, image) for image in self.layout.images}

    def state(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the vector of an observation, (..., n), without frames.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        raw = self._state.gathered(observation)
        self._plan.write(observation, raw)
        return self._state.scaled(raw)

    def observation_dict(self, flat: Any) -> dict[str, Any]:
        """Return the dictionary of a flat observation: the inverse of `observation`, with the keys that it has.

        Frames are views with channels last; depth has the steps of its levels.

        Raises:
            InvalidSetup: The vector has a wrong shape.
        """
        vector = flat if not self.layout.images else flat.get(STATE, np.zeros(0))
        given = np.asarray(vector, np.float64)
        size = self.layout.state_size
        if given.ndim == 0 or given.shape[-1] != size:
            raise InvalidSetup(f"The vector has shape {given.shape}; valid is (..., {size}).")
        nested = self._state.nested(given * self._state.scale + self._state.offset)
        for image in self.layout.images:
            _put(nested, image.path, _frame(np.asarray(flat[image.name]), image))
        return nested

    def __repr__(self) -> str:
        """Return the sizes."""
        images = "".join(f", {image.name} {'x'.join(map(str, image.shape))}" for image in self.layout.images)
        return f"Flat({self.layout.state_size} numbers{images} -> {self.layout.action_size} numbers)"


class _Table:
    """Entries as arrays of offsets and scales, and where values come from and go to."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        def joined(name: str) -> NDArray[np.float64]:
            return np.array([one for entry in entries for one in getattr(entry, name)], np.float64)

        self.offset, self.scale = joined("offset"), joined("scale")
        self.low, self.high = (joined(name).astype(np.float32) for name in ("low", "high"))
        self._size = len(self.scale)
        self._values = [entry for entry in entries if entry.kind == "value"]
        self._reads = [
            (entry.path, len(entry.shape), entry.shape, entry.slice, _whole(entry)) for entry in self._values
        ]
        self._turns = {entry.path: entry.slice for entry in entries if entry.kind == "turn"}

    def gathered(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return values in the units of their keys, (..., n); those that follow from others are still missing."""
        raw: NDArray[np.float64] | None = None
        for path, ndim, shape, place, picked in self._reads:
            array = _at(values, path)
            leading = array.shape[: array.ndim - ndim]
            if array.shape[len(leading) :] != shape:
                raise InvalidSetup(f"{'/'.join(path)!r} has shape {array.shape}; valid is (..., {_list(shape)}).")
            if raw is None:
                raw = np.zeros((*leading, self._size))
            if ndim != 1:
                array = array.reshape(*leading, -1)
            try:
                raw[..., place] = array if picked is None else array[..., picked]
            except ValueError as err:
                raise InvalidSetup(f"{'/'.join(path)!r} has shape {array.shape}, unlike the keys before it.") from err
        return np.zeros(self._size) if raw is None else raw

    def scaled(self, raw: NDArray[np.float64]) -> NDArray[np.float32]:
        raw -= self.offset
        raw /= self.scale
        return raw.astype(np.float32)

    def nested(self, values: NDArray[np.float64]) -> dict[str, Any]:
        """Return dictionaries of values in the units of their keys, (..., n)."""
        nested: dict[str, Any] = {}
        leading = values.shape[:-1]
        for entry in self._values:
            part = values[..., entry.slice]
            if entry.path in self._turns:
                pose = np.concatenate([part, np.zeros((*leading, 4))], -1)
                pose[..., 3:] = _quaternion(values[..., self._turns[entry.path]])
                part = pose
            dtype = np.dtype(entry.dtype)
            part = np.rint(part) if dtype.kind in "iub" else part
            _put(nested, entry.path, part.reshape(*leading, *entry.shape).astype(dtype))
        return nested


class _PosePlan:
    """Computes what entries tell of rotations and of pairs of poses, for all of them at once."""

    def __init__(self, entries: Sequence[Entry], bases: Mapping[str, NDArray[np.float64]]) -> None:
        derived = [entry for entry in entries if entry.kind != "value"]
        self._paths = list(dict.fromkeys(path for entry in derived for path in (entry.path, entry.to) if path))
        number = {path: i for i, path in enumerate(self._paths)}
        # Of several robots, each TCP is in the frame of its own base, and objects are in the scene.
        self._bases = {number[path]: bases[path[0]] for path in self._paths if path[0] in bases}

        def of(kind: str) -> list[Entry]:
            return [entry for entry in derived if entry.kind == kind]

        self._turns = [(number[entry.path], entry.slice) for entry in of("turn")]
        self._offsets = [(number[entry.path], number[entry.to], entry.slice) for entry in of("offset")]
        pairs = of("relative_turn")
        self._first, self._second = [number[one.path] for one in pairs], [number[one.to] for one in pairs]
        self._relative = [entry.slice for entry in pairs]

    def write(self, observation: Mapping[str, Any], raw: NDArray[np.float64]) -> None:
        """Write the entries into a vector (..., n)."""
        if not self._paths:
            return
        poses = np.empty((*raw.shape[:-1], len(self._paths), 7))
        for i, path in enumerate(self._paths):
            poses[..., i, :] = _at(observation, path)
        poses = normalize(poses)
        turns = [poses[..., i, :] for i, _ in self._turns]
        in_scene = poses
        if self._bases:
            in_scene = poses.copy()
            for i, base in self._bases.items():
                in_scene[..., i, :] = compose(base, poses[..., i, :])
        for first, second, place in self._offsets:
            raw[..., place] = in_scene[..., second, :3] - in_scene[..., first, :3]
        places = [place for _, place in self._turns] + self._relative
        if not places:
            return
        all_turns = np.stack(turns, -2) if turns else poses[..., :0, :]
        if self._relative:
            pairs = relative(in_scene[..., self._first, :], in_scene[..., self._second, :])
            all_turns = np.concatenate([all_turns, pairs], -2)
        matrices = tquat_to_matrix(all_turns)
        columns = matrices[..., :3, :2].swapaxes(-1, -2).reshape(*raw.shape[:-1], len(places), 6)
        for i, place in enumerate(places):
            raw[..., place] = columns[..., i, :]


def _whole(entry: Entry) -> slice | None:
    """Return which numbers of a key an entry has; None for all."""
    return None if entry.picked == (0, int(np.prod(entry.shape, dtype=int))) else slice(*entry.picked)


def _quaternion(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions xyzw, w >= 0, of two columns of rotation matrices (..., 6), up to their rounding."""
    x, y = columns[..., :3], columns[..., 3:]
    x = x / _norm(x)
    y = y - (x * y).sum(-1, keepdims=True) * x
    y = y / _norm(y)
    matrix = np.zeros((*columns.shape[:-1], 4, 4))
    matrix[..., :3, 0], matrix[..., :3, 1], matrix[..., :3, 2], matrix[..., 3, 3] = x, y, np.cross(x, y), 1.0
    return matrix_to_tquat(matrix)[..., 3:]


def _norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    norms = np.sqrt((vectors * vectors).sum(-1, keepdims=True))
    if not (norms > 1e-3).all():
        raise InvalidSetup("The columns of a rotation in the vector are not two different directions.")
    return norms


def _at(values: Mapping[str, Any], path: Path) -> NDArray[Any]:
    found: Any = values
    for key in path:
        try:
            found = found[key]
        except (KeyError, TypeError, IndexError) as err:
            raise InvalidSetup(f"{'/'.join(path)!r} is missing; given: {_keys(values)}.") from err
    return found if type(found) is np.ndarray else np.asarray(found)


def _keys(values: Any) -> str:
    return ", ".join(map(str, values)) if isinstance(values, Mapping) else type(values).__name__


def _list(shape: Sequence[int]) -> str:
    return ", ".join(map(str, shape))


def _put(nested: dict[str, Any], path: Path, value: Any) -> None:
    for key in path[:-1]:
        nested = nested.setdefault(key, {})
    nested[path[-1]] = value


def _picture(observation: Mapping[str, Any], image: Image) -> NDArray[np.uint8]:
    frame = _at(observation, image.path)
    if image.is_depth:
        return np.minimum(frame // np.uint16(image.level_mm), 255).astype(np.uint8)[..., None, :, :]
    if frame.shape[-3:] == image.shape:
        return frame
    return np.ascontiguousarray(np.moveaxis(frame, -1, -3))


def _frame(picture: NDArray[np.uint8], image: Image) -> NDArray[Any]:
    if image.is_depth:
        return picture[..., 0, :, :].astype(np.uint16) * np.uint16(image.level_mm)
    return np.moveaxis(picture, -3, -1)
