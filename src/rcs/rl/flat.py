"""Maps between the dictionaries of an environment and the vectors of learners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs.env import Env
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidAction, InvalidSetup
from rcs.rl.layout import Entry, FlatLayout, Image, Kind, layout_of
from rcs.spatial import compose, normalize, relative, tquat_to_matrix

STATE = "state"
"""Key of the vector in a flat observation that has images too."""


class Flat:
    """Maps between dictionaries and vectors, for one environment, many copies, or a policy without any.

    Arrays are indexed from the right: an observation of one copy, (n,) per key, becomes a vector, one of many copies,
    (copies, n), a matrix. The maps remember nothing, and the same numbers give the same bits in a batch of any size.

    Actions: -1 and 1 are the bounds of every number; vectors are clipped to them. Observations: each number is
    `(value - offset) / scale`, about -1 to 1 in what usually occurs, and never clipped. `print(flat.layout)` lists
    them.
    """

    def __init__(self, of: Env | VecEnv | FlatLayout, *, keys: Sequence[str] | None = None) -> None:
        """Prepare the maps.

        Args:
            of: An environment, also under Gymnasium's wrappers, or the layout of another Flat.
            keys: Observed keys of the environment besides frames, such as `joints`, `privileged/cuboid` or, of several
                robots, `left`; a key of a dictionary selects all keys inside. None for all but `xyzrpy`, which says the
                same as `tquat`.

        Raises:
            InvalidSetup: A space is not one of numbers, a key is unknown, or nothing is left.
        """
        if isinstance(of, FlatLayout) and keys is not None:
            raise InvalidSetup("A layout was given and also keys; the layout says what the vectors have.")
        self.layout = of if isinstance(of, FlatLayout) else layout_of(of, keys)
        """The layout of the vectors."""
        layout = self.layout
        self._action, self._state = _Scaling(layout.action), _Scaling(layout.state)
        self._poses = _PoseFeatures(layout)
        self.action_space = spaces.Box(-1.0, 1.0, (layout.action_size,), np.float32)
        """The space of vectors of one action."""
        state_space = spaces.Box(-np.inf, np.inf, (layout.state_size,), np.float32)
        self.observation_space: spaces.Box | spaces.Dict = state_space
        """The space of one flat observation: the vector, or, with cameras, a dictionary with the vector as `state` and
        a frame (channels, height, width) per camera."""
        if layout.images:
            frames: dict[str, spaces.Space[Any]] = {
                image.name: spaces.Box(0, 255, image.shape, np.uint8) for image in layout.images
            }
            self.observation_space = spaces.Dict(({STATE: state_space} if layout.state else {}) | frames)

    def action(self, vector: ArrayLike) -> dict[str, Any]:
        """Return the action of a vector.

        Args:
            vector: Shape (..., n); numbers beyond -1 and 1 count as -1 and 1.

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
        return self._action.values(np.minimum(np.maximum(given, -1.0), 1.0))

    def action_vector(self, action: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the vector of an action, (..., n): the inverse of `action`.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        return self._action.scaled(self._action.gathered(action)).astype(np.float32)

    def observation(self, observation: Mapping[str, Any]) -> Any:
        """Return the flat observation: a vector (..., n), or, with cameras, a dictionary with it and the frames.

        All arrays are new, except frames that have their channels first already.

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
        vector = self._state.gathered(observation)
        if names := self._poses.poses:
            poses = np.empty((*vector.shape[:-1], len(names), 7))
            for i, name in enumerate(names):
                poses[..., i, :] = _at(observation, name.split("/"))
            self._poses.write(poses, vector)
        self._state.scaled(vector)
        self._poses.bound(vector)
        return vector.astype(np.float32)

    def __repr__(self) -> str:
        """Return the sizes."""
        images = "".join(f", {image.name} {'x'.join(map(str, image.shape))}" for image in self.layout.images)
        return f"Flat({self.layout.state_size} numbers{images} -> {self.layout.action_size} numbers)"


class FlatEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment whose actions and observations are vectors.

    Examples:
        >>> env = FlatEnv(rcs.make("PickCuboid", observe=("privileged",)))
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    def __init__(self, env: gymnasium.Env[Any, Any], *, keys: Sequence[str] | None = None) -> None:
        """Wrap an environment.

        Args:
            env: Made by `rcs.make`, also under Gymnasium's wrappers.
            keys: Observed keys; see `Flat`.

        Raises:
            InvalidSetup: See `Flat`.
        """
        super().__init__(env)
        self.flat = Flat(env, keys=keys)  # pyright: ignore[reportArgumentType]  a wrapped one is an Env inside
        """The maps."""
        self.action_space, self.observation_space = self.flat.action_space, self.flat.observation_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode and return its first flat observation and the info."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.flat.observation(observation), info

    def step(self, action: ArrayLike) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Make a step with a vector as the action; see `Flat.action`."""
        observation, reward, terminated, truncated, info = self.env.step(self.flat.action(action))
        return self.flat.observation(observation), reward, terminated, truncated, info


class _PoseFeatures:
    """Computes all entries that follow from poses: the last of a vector, kind by kind, as a layout orders them."""

    def __init__(self, layout: FlatLayout) -> None:
        def of(kind: Kind) -> list[Entry]:
            return [entry for entry in layout.state if entry.kind == kind]

        self.poses = [entry.key for entry in of("turn")]
        """Keys of the poses that are read."""
        self._begin = sum(entry.size for entry in layout.state if entry.kind == "value")
        number = {key: i for i, key in enumerate(self.poses)}
        self._first, self._second = ([number[getattr(entry, end)] for entry in of("offset")] for end in ("key", "to"))
        self._halves = len(of("half_turn"))  # of the first pairs
        near = self._begin + 6 * len(self.poses) + 3 * len(self._first)
        self._near = slice(near, near + 3 * len(self._first))
        # For several robots, each TCP is in the frame of its own base, and objects are in the scene.
        robots = {i: key.partition("/")[0] for i, key in enumerate(self.poses)}
        self._bases = {i: np.array(layout.bases[robot]) for i, robot in robots.items() if robot in layout.bases}

    def write(self, poses: NDArray[np.float64], raw: NDArray[np.float64]) -> None:
        """Write them, in their units.

        Args:
            poses: The poses of the keys in `poses`, (..., poses, 7) [m], xyzw.
            raw: The vector.
        """
        poses = normalize(poses)
        parts = [_columns(poses)]
        if self._first:
            for i, base in self._bases.items():
                poses[..., i, :] = compose(base, poses[..., i, :])
            first, second = poses.take(self._first, axis=-2), poses.take(self._second, axis=-2)
            ways, turns = (second - first)[..., :3], _columns(relative(first, second))
            # The second pose's x axis in the x-y plane of the first, at twice its angle.
            x, y = turns[..., : self._halves, 0], turns[..., : self._halves, 1]
            parts += [ways, ways, turns, np.stack([x * x - y * y, 2.0 * x * y], -1)]
        raw[..., self._begin :] = np.concatenate([part.reshape(*raw.shape[:-1], -1) for part in parts], -1)

    def bound(self, vector: NDArray[np.float64]) -> None:
        """Bring the `near` numbers of a scaled vector (..., n) between -1 and 1."""
        far = vector[..., self._near]
        vector[..., self._near] = far / np.sqrt(1.0 + far * far)


def _columns(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first two columns of the rotation matrices of poses, (..., 6)."""
    columns = tquat_to_matrix(poses)[..., :3, :2].swapaxes(-1, -2)
    return columns.reshape(*poses.shape[:-1], 6)


class _Scaling:
    """Gathers the numbers of all value entries in one vector, scales them, and scatters them again."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._offset, self._scale = (
            np.array([one for entry in entries for one in getattr(entry, name)], np.float64)
            for name in ("offset", "scale")
        )
        ends = np.cumsum([entry.size for entry in entries]).tolist()
        self._values = [
            (entry, entry.key.split("/"), slice(end - entry.size, end))
            for entry, end in zip(entries, ends, strict=True)
            if entry.kind == "value"
        ]

    def gathered(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the numbers of keys in their units, (..., n); 0 for features of poses.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        raw: NDArray[np.float64] | None = None
        for entry, path, place in self._values:
            array = _at(values, path)
            leading = array.shape[: array.ndim - len(entry.shape)]
            if array.shape[len(leading) :] != entry.shape:
                valid = ", ".join(("...", *map(str, entry.shape)))
                raise InvalidSetup(f"{entry.key!r} has shape {array.shape}; valid is ({valid}).")
            if raw is None:
                raw = np.zeros((*leading, len(self._scale)))
            elif raw.shape[:-1] != leading:
                raise InvalidSetup(f"{entry.key!r} has shape {array.shape}, unlike the keys before it.")
            raw[..., place] = array.reshape(*leading, -1)[..., : entry.size]
        return np.zeros(len(self._scale)) if raw is None else raw

    def scaled(self, raw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn numbers in the units of their keys, (..., n), into those of the vector, in place."""
        raw -= self._offset
        raw /= self._scale
        return raw

    def values(self, vector: NDArray[np.float64]) -> dict[str, Any]:
        """Return the dictionary of a vector, (..., n), of values alone."""
        numbers = vector * self._scale + self._offset
        nested: dict[str, Any] = {}
        for entry, path, place in self._values:
            inner = nested
            for key in path[:-1]:
                inner = inner.setdefault(key, {})
            inner[path[-1]] = numbers[..., place].reshape(*vector.shape[:-1], *entry.shape).astype(entry.dtype)
        return nested


def _at(values: Mapping[str, Any], path: Sequence[str]) -> NDArray[Any]:
    """Return the array at a path of keys.

    Raises:
        InvalidSetup: There is none.
    """
    found: Any = values
    try:
        for key in path:
            found = found[key]
    except (KeyError, TypeError, IndexError) as err:
        given = ", ".join(map(str, values)) if isinstance(values, Mapping) else type(values).__name__
        raise InvalidSetup(f"{'/'.join(path)!r} is missing; given: {given}.") from err
    return np.asarray(found)


def _picture(observation: Mapping[str, Any], image: Image) -> NDArray[np.uint8]:
    frame = _at(observation, image.key.split("/"))
    if frame.shape[-3:] == image.shape:
        return frame
    return np.ascontiguousarray(np.moveaxis(frame, -1, -3))
