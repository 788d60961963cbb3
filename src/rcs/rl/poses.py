"""What a layout tells of rotations and of pairs of poses, of all of them at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.rl.layout import Entry, Kind, Path
from rcs.spatial import compose, matrix_to_tquat, normalize, relative, tquat_to_matrix


class PosePlan:
    """Which poses are read, and what is computed of them."""

    def __init__(self, entries: Sequence[Entry], bases: Mapping[str, NDArray[np.float64]]) -> None:
        """Prepare it.

        Args:
            entries: Of an observation.
            bases: Of several robots, poses of the bases in the scene, (7,) [m], xyzw.
        """
        derived = [entry for entry in entries if entry.kind != "value"]
        self.paths: list[Path] = list(
            dict.fromkeys(path for entry in derived for path in (entry.path, entry.to) if path)
        )
        """The poses that are read."""
        number = {path: i for i, path in enumerate(self.paths)}
        # Of several robots, each TCP is in the frame of its own base, and objects are in the scene.
        self._bases = {number[path]: bases[path[0]] for path in self.paths if path[0] in bases}

        def of(*kinds: Kind) -> list[Entry]:
            return [entry for kind in kinds for entry in derived if entry.kind == kind]

        turns, ways, relative_turns, halves = of("turn"), of("offset", "near"), of("relative_turn"), of("half_turn")
        pairs = list(dict.fromkeys((number[one.path], number[one.to]) for one in derived if one.to))
        self._first, self._second = [first for first, _ in pairs], [second for _, second in pairs]
        of_pair = {pair: i for i, pair in enumerate(pairs)}

        def chosen(entries: Sequence[Entry]) -> NDArray[np.intp]:
            return np.array([of_pair[number[one.path], number[one.to]] for one in entries], np.intp)

        self._turns = np.array([number[one.path] for one in turns], np.intp)
        self._ways, self._way_places = chosen(ways), _places(ways)
        self._turned = chosen([*relative_turns, *halves])
        self._count = len(turns) + len(relative_turns)
        self._columns, self._halves = _places([*turns, *relative_turns]), _places(halves)
        self._near = _places(of("near"))

    def write(self, poses: NDArray[np.float64], raw: NDArray[np.float64]) -> None:
        """Write all entries into a vector (..., n), in their units.

        Args:
            poses: The poses of `paths`, (..., poses, 7) [m], xyzw.
            raw: The vector.
        """
        leading = raw.shape[:-1]
        poses = normalize(poses)
        turns = poses.take(self._turns, axis=-2)
        if self._first:
            for i, base in self._bases.items():
                poses[..., i, :] = compose(base, poses[..., i, :])
            first, second = poses.take(self._first, axis=-2), poses.take(self._second, axis=-2)
            if self._way_places is not None:
                ways = (second - first)[..., :3].take(self._ways, axis=-2)
                raw[..., self._way_places] = ways.reshape(*leading, -1)
            if len(self._turned):
                turns = np.concatenate([turns, relative(first, second).take(self._turned, axis=-2)], -2)
        columns = tquat_to_matrix(turns)[..., :3, :2].swapaxes(-1, -2)
        if self._columns is not None:
            raw[..., self._columns] = columns[..., : self._count, :, :].reshape(*leading, -1)
        if self._halves is not None:
            # The other's x axis in the x-y plane of the first, at twice its angle.
            x, y = columns[..., self._count :, 0, 0], columns[..., self._count :, 0, 1]
            raw[..., self._halves] = np.stack([x * x - y * y, 2.0 * x * y], -1).reshape(*leading, -1)

    def bound(self, vector: NDArray[np.float64]) -> None:
        """Bring the `near` numbers of a scaled vector (..., n) between -1 and 1."""
        if self._near is not None:
            far = vector[..., self._near]
            vector[..., self._near] = far / np.sqrt(1.0 + far * far)


def _places(entries: Sequence[Entry]) -> Any:
    """Return the places of entries in a vector, as a slice if they follow each other; None if there are none."""
    if not entries:
        return None
    places = np.concatenate([np.arange(*entry.place) for entry in entries])
    first, end = entries[0].place[0], entries[-1].place[1]
    return slice(first, end) if np.array_equal(places, np.arange(first, end)) else places


def quaternion(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions xyzw, w >= 0, of the first two columns of rotation matrices.

    Args:
        columns: The first column, then the second, (..., 6), up to rounding.

    Raises:
        InvalidSetup: They are not two different directions.
    """
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
