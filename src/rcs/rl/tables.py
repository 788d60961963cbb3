"""The entries of a layout as arrays: from dictionaries to scaled vectors, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.rl.layout import Entry, Path
from rcs.rl.poses import quaternion


class Table:
    """Offsets and scales of all entries, and where the numbers of keys come from and go to."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        """Prepare the arrays."""
        self.offset, self.scale = (_joined(entries, name) for name in ("offset", "scale"))
        self.low, self.high = (_joined(entries, name).astype(np.float32) for name in ("low", "high"))
        self.size = len(self.scale)
        self._values = [entry for entry in entries if entry.kind == "value"]
        self._reads = [(one.path, len(one.shape), one.shape, one.slice, _part(one)) for one in self._values]
        self._turns = {entry.path: entry.slice for entry in entries if entry.kind == "turn"}
        self._rests = {entry.path: entry for entry in self._values if entry.rest}

    def gathered(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the numbers of keys in their units, (..., n); 0 where entries follow from others.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        raw: NDArray[np.float64] | None = None
        for path, ndim, shape, place, part in self._reads:
            array = at(values, path)
            leading = array.shape[: array.ndim - ndim]
            if array.shape[len(leading) :] != shape:
                valid = ", ".join(("...", *map(str, shape)))
                raise InvalidSetup(f"{'/'.join(path)!r} has shape {array.shape}; valid is ({valid}).")
            if raw is None:
                raw = np.zeros((*leading, self.size))
            elif raw.shape[:-1] != leading:
                raise InvalidSetup(f"{'/'.join(path)!r} has shape {array.shape}, unlike the keys before it.")
            if ndim != 1:
                array = array.reshape(*leading, -1)
            raw[..., place] = array if part is None else array[..., part]
        return np.zeros(self.size) if raw is None else raw

    def scale_in_place(self, raw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn numbers in the units of their keys, (..., n), into those of the vector."""
        raw -= self.offset
        raw /= self.scale
        return raw

    def nested(self, vector: NDArray[np.float64]) -> dict[str, Any]:
        """Return dictionaries of the numbers of a vector, (..., n)."""
        values = vector * self.scale + self.offset
        nested: dict[str, Any] = {}
        leading = values.shape[:-1]
        whole = {path: np.tile(np.array(one.rest), (*leading, 1)) for path, one in self._rests.items()}
        for entry in self._values:
            numbers = values[..., entry.slice]
            if entry.path in self._turns:
                turn = quaternion(values[..., self._turns[entry.path]])
                numbers = np.concatenate([numbers, turn], -1)
            elif entry.path in whole:
                whole[entry.path][..., slice(*entry.picked)] = numbers
                numbers = whole[entry.path]
            dtype = np.dtype(entry.dtype)
            if dtype.kind in "iub":
                numbers = np.rint(numbers)
            put(nested, entry.path, numbers.reshape(*leading, *entry.shape).astype(dtype))
        return nested


def at(values: Mapping[str, Any], path: Path) -> NDArray[Any]:
    """Return the array at a path.

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
    return found if type(found) is np.ndarray else np.asarray(found)


def put(nested: dict[str, Any], path: Path, value: Any) -> None:
    """Put a value at a path."""
    for key in path[:-1]:
        nested = nested.setdefault(key, {})
    nested[path[-1]] = value


def _joined(entries: Sequence[Entry], name: str) -> NDArray[np.float64]:
    return np.array([one for entry in entries for one in getattr(entry, name)], np.float64)


def _part(entry: Entry) -> slice | None:
    """Return which numbers of a key an entry has; None for all."""
    return None if entry.picked == (0, int(np.prod(entry.shape, dtype=int))) else slice(*entry.picked)
