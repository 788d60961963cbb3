"""Rows in memory: each is checked when it is added, and many at a time become one Arrow batch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.errors import InvalidSetup
from rcs_data.files.codec import encode_frame, is_file
from rcs_data.files.feature import Feature
from rcs_data.files.flags import FrameFlag, companion
from rcs_data.files.info import DatasetInfo

Value = NDArray[Any] | np.generic | float | bool | bytes | None
"""A value in a row; None where nothing was measured or no image is new. An image may also be the bytes of a file in the
encoding of its feature."""

_CAPACITY = 64


class RowBuffer:
    """The rows of one episode that are not on the disk yet."""

    def __init__(self, info: DatasetInfo) -> None:
        """Make an empty buffer.

        Args:
            info: The features of a row.
        """
        self._info = info
        self._schema = info.stream_schema
        self._keys = frozenset(feature.key for feature in info.features)
        self._needed = frozenset(f.key for f in info.features if not f.is_flags)
        self._needed_at_reset = frozenset(
            f.key for f in info.features if not (f.is_flags or f.is_unknown_at_reset or f.is_optional_at_reset)
        )
        self._numbers = {f.key: np.zeros((_CAPACITY, *f.shape), f.numpy_dtype) for f in info.features if not f.is_image}
        self._images: dict[str, list[bytes | None]] = {f.key: [] for f in info.features if f.is_image}
        self._flags = {key: companion(key, info.features, "flags") for key in self._images}
        self._sim_states = np.zeros((_CAPACITY, info.sim_state_size or 0))
        self._image_bytes = 0
        # Simulations record faster than real time, so this is half a second of the episode, not of the wall clock.
        self._capacity = max(1, min(_CAPACITY, int(info.frequency / 2)))
        self.rows = 0
        """Number of buffered rows."""
        self._at_reset = True
        self._null_at_reset: set[str] = set()

    @property
    def is_full(self) -> bool:
        """Whether the rows must be taken before another can be added."""
        # The first row has empty columns, so it is a batch of its own. A megabyte of images is worth a write; more
        # would block other threads for milliseconds.
        return self.rows >= self._capacity or self._at_reset or self._image_bytes > 1 << 20

    def check(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None, *, is_first: bool) -> None:
        """Refuse an invalid row; changes nothing, so another thread may add rows meanwhile.

        Args:
            row: A value for each feature.
            sim_state: The simulation's state, shape (sim_state_size,); None without a simulation.
            is_first: Whether it is the reset observation.

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong.
        """
        self._check_keys(row, is_first)
        self._check_sim_state(sim_state)
        for feature in self._info.features:
            _check_value(feature, row.get(feature.key), is_first)

    def add(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None) -> None:
        """Check one row and buffer it; a refused row leaves no trace.

        Args:
            row: A value for each feature; the first row is the reset observation, without action and reward.
            sim_state: The simulation's state, shape (sim_state_size,); None without a simulation.

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong.
        """
        is_first = self.rows == 0 and self._at_reset
        self.check(row, sim_state, is_first=is_first)
        i = self.rows
        images: dict[str, bytes | None] = {}
        for feature in self._info.features:
            value: Any = row.get(feature.key)
            if feature.is_image:
                if value is not None and not isinstance(value, bytes):
                    value = encode_frame(feature, value, self._info)
                images[feature.key] = value
            elif value is not None:
                self._numbers[feature.key][i] = value
            elif feature.is_time:
                self._numbers[feature.key][i] = math.nan
            elif feature.is_flags:
                self._numbers[feature.key][i] = 0
        for key, data in images.items():
            self._images[key].append(data)
            self._image_bytes += len(data or b"")
            flags = self._flags[key]
            if data is None and flags is not None and not self._numbers[flags][i]:
                self._numbers[flags][i] = FrameFlag.MISSING  # no image, and no flag to say why
        if sim_state is not None:
            self._sim_states[i] = sim_state
        if is_first:
            features = (f for f in self._info.features if not f.is_flags)
            self._null_at_reset = {f.key for f in features if row.get(f.key) is None}
        self.rows += 1

    def take(self) -> pa.RecordBatch:
        """Return the rows and empty the buffer; the batch is valid until the next `add`."""
        n = self.rows
        arrays = [self._array(feature, n) for feature in self._info.features]
        if self._info.sim_state_size is not None:
            flat = pa.array(self._sim_states[:n].reshape(-1))
            arrays.append(pa.FixedSizeListArray.from_arrays(flat, self._info.sim_state_size))
        batch = pa.RecordBatch.from_arrays(arrays, schema=self._schema)
        for images in self._images.values():
            images.clear()
        self._image_bytes = 0
        self.rows = 0
        self._at_reset = False
        return batch

    def _array(self, feature: Feature, n: int) -> pa.Array:
        if self._at_reset and feature.key in self._null_at_reset:
            return pa.nulls(n, feature.arrow_type)
        if feature.is_image:
            return pa.array(self._images[feature.key], type=pa.binary())
        numbers = self._numbers[feature.key][:n]
        if feature.is_time:
            return pa.array(numbers, mask=np.isnan(numbers))
        if feature.shape == ():
            return pa.array(numbers)
        return pa.FixedSizeListArray.from_arrays(pa.array(numbers.reshape(-1)), feature.size)

    def _check_keys(self, row: Mapping[str, Value], is_first: bool) -> None:
        given = row.keys()
        needed = self._needed_at_reset if is_first else self._needed
        if needed <= given <= self._keys:
            return
        wrong = [f"missing {', '.join(sorted(needed - given))}"] if needed - given else []
        wrong += [f"unknown {', '.join(sorted(given - self._keys))}"] if given - self._keys else []
        raise InvalidSetup(
            f"A row has other keys than the dataset: {'; '.join(wrong)}. Valid are {', '.join(sorted(self._keys))}."
        )

    def _check_sim_state(self, sim_state: NDArray[np.float64] | None) -> None:
        size = self._info.sim_state_size
        if sim_state is None and size is None:
            return
        if sim_state is None or size is None:
            expected = "None, because sim_state_size is None" if size is None else f"({size},) float64"
            raise InvalidSetup(f"Expected sim_state to be {expected}; got {_form(sim_state)}.")
        if sim_state.shape != (size,) or sim_state.dtype != np.float64:
            raise InvalidSetup(f"Expected sim_state to be ({size},) float64; got {_form(sim_state)}.")


def _check_value(feature: Feature, value: Value, is_first: bool) -> None:
    if value is None:
        if feature.is_time or feature.is_flags or feature.is_image:
            return
        if is_first and (feature.is_unknown_at_reset or feature.is_optional_at_reset):
            return
        raise InvalidSetup(f"{feature.key!r} is None; expected {feature.shape} {feature.dtype}.")
    if is_first and feature.is_unknown_at_reset:
        raise InvalidSetup(
            f"{feature.key!r} is {_form(value)} in the first row; it must be None or left out, "
            "since it is the reset observation, which no action precedes."
        )
    if feature.is_image and isinstance(value, bytes):
        if not is_file(feature, value):
            raise InvalidSetup(
                f"{feature.key!r} is {len(value)} bytes that are no file of its encoding, {feature.encoding!r}; give "
                f"such a file, whole, or an array, {feature.shape} {feature.dtype}."
            )
        return
    if isinstance(value, np.ndarray):
        if value.shape != feature.shape or value.dtype != feature.dtype:
            raise InvalidSetup(f"{feature.key!r} is {_form(value)}; expected {feature.shape} {feature.dtype}.")
    elif feature.shape != () or not _fits(value, feature.numpy_dtype):
        raise InvalidSetup(f"{feature.key!r} is {_form(value)}; expected {feature.shape} {feature.dtype}.")
    if feature.is_time and not math.isfinite(float(value)):
        raise InvalidSetup(f"{feature.key!r} is {value}; a time must be finite, or None where none was measured.")


def _fits(value: object, dtype: np.dtype[Any]) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return dtype.kind == "b"
    if isinstance(value, (int, np.integer)):
        if dtype.kind in "iu":
            return int(np.iinfo(dtype).min) <= int(value) <= int(np.iinfo(dtype).max)
        return dtype.kind == "f"
    return isinstance(value, (float, np.floating)) and dtype.kind == "f"


def _form(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    return f"{value!r} ({type(value).__name__})"
