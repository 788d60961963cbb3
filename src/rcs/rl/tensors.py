"""Values of a training in files, with torch's own format: arrays, tensors and numbers, and never code."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.errors import CorruptCheckpoint
from rcs.rl.packages import package

_ARRAY = "__array__"
"""Key of an array's bytes; torch has no type for all of NumPy's."""


def to_bytes(values: Mapping[str, Any]) -> bytes:
    """Return nested dictionaries, lists and tuples of tensors, arrays, numbers and texts as the bytes of a file."""
    file = io.BytesIO()
    package("torch").save(_stored(values), file)
    return file.getvalue()


def from_bytes(data: bytes, name: str) -> dict[str, Any]:
    """Return the values that `to_bytes` wrote, tensors on the CPU; nothing in the bytes is run.

    Args:
        data: The bytes.
        name: Where they are from, for the message.

    Raises:
        CorruptCheckpoint: They are not such values.
    """
    try:
        values = _restored(package("torch").load(io.BytesIO(data), map_location="cpu", weights_only=True))
    except CorruptCheckpoint:
        raise
    except Exception as err:  # torch raises whatever the damage leads to
        raise CorruptCheckpoint(f"{name} is damaged: {type(err).__name__}: {str(err).splitlines()[0]}") from err
    if not isinstance(values, dict):
        raise CorruptCheckpoint(f"{name} is damaged: it has no values by name.")
    return values


def _stored(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _stored(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_stored(own) for own in value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"an array of {value.dtype} cannot be stored")
        raw = np.frombuffer(value.tobytes(), np.uint8).copy()
        return {_ARRAY: package("torch").from_numpy(raw), "dtype": value.dtype.str, "shape": list(value.shape)}
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, dict):
        if _ARRAY in value:
            return _array(value)
        return {key: _restored(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_restored(own) for own in value)
    return value


def _array(value: dict[str, Any]) -> Any:
    dtype, shape = np.dtype(str(value["dtype"])), tuple(map(int, value["shape"]))
    raw = value[_ARRAY].numpy()
    if dtype.kind not in "biuf" or min(shape, default=0) < 0 or raw.nbytes != math.prod(shape) * dtype.itemsize:
        raise CorruptCheckpoint("An array has another size than its shape.")
    return raw.view(dtype).reshape(shape).copy()
