"""openpi's messages: one msgpack per observation and per answer, arrays inside it as bytes.

Layout as in openpi's `msgpack_numpy.py`: an array is a map with the bytes `__ndarray__`, `data`, `dtype`, `shape` as
keys, a NumPy scalar one with `__npgeneric__`, `data`, `dtype`. A flat dictionary of arrays and `prompt` goes there;
`actions`, (horizon, size), come back.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import BadMessage, InvalidInput
from vlagents.observation import Observation
from vlagents.wire import bulk
from vlagents.wire.bulk import LARGE
from vlagents.wire.message import DTYPES, array_of, encode

OWN = "vlagents"
"""Key of our additions, which both sides of ours use: session, time, and calls other than for actions."""
PROMPT = "prompt"
ACTIONS = "actions"
ARRAY_HEAD = b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data"
"""First bytes of an array."""
DEEPEST = 4
"""Most dictionaries inside each other."""


def pack(values: Any) -> bytes:
    """Return values as openpi sends them.

    Raises:
        InvalidInput: A value does not travel.
    """
    return encode(values, _array_to_map, _number_to_map)


def pack_parts(values: Mapping[str, Any]) -> list[bytes | memoryview]:
    """Return values as openpi sends them, in parts: large arrays of the outermost dictionary are not copied.

    Raises:
        InvalidInput: A value does not travel.
    """
    parts: list[bytes | memoryview] = []
    small = [bytes([0x80 | len(values)]) if len(values) < 16 else struct.pack(">BH", 0xDE, len(values))]
    for name, value in values.items():
        small.append(pack(name))
        if isinstance(value, np.ndarray) and value.nbytes >= LARGE and value.dtype.str in DTYPES:
            as_map = _array_to_map(value)
            data = as_map[b"data"]
            parts += [b"".join([*small, ARRAY_HEAD, struct.pack(">BI", 0xC6, len(data))]), data]
            small = [pack(b"dtype"), pack(as_map[b"dtype"]), pack(b"shape"), pack(as_map[b"shape"])]
        else:
            small.append(pack(value))
    return [*parts, b"".join(small)]


def unpack(data: bytes | memoryview) -> Any:
    """Read a message of openpi. Large arrays are views of the data; all are writable if the data is.

    Raises:
        BadMessage: It is no such message, or has more than `LARGEST_HEADER` bytes beside its large arrays.
    """
    return bulk.unpack(data, _from_map)


def observation_to_flat(observation: Observation) -> dict[str, Any]:
    """Return an observation as a flat dictionary, with the names of images and parts as keys.

    Raises:
        InvalidInput: It has goals, which openpi does not know, or two inputs of the same name.
    """
    flat: dict[str, Any] = {name: observation.image(name) for name in observation.images}
    if observation.goals:
        raise InvalidInput("openpi's observations have no goals.")
    for name, part in observation.state.items():
        if name in flat or name == PROMPT:
            raise InvalidInput(f"openpi's observations are flat; two things are called {name!r}.")
        flat[name] = np.asarray(part)
    if observation.instruction:
        flat[PROMPT] = observation.instruction
    return flat


def observation_from_flat(given: object, session: str = "", time: float = 0.0) -> Observation:
    """Read an observation: bytes with three axes are images, numbers with one are state, `prompt` is the instruction.

    Names in nested dictionaries are joined by slashes; images with the channels first are transposed.

    Raises:
        InvalidInput: A value is none of these.
    """
    images: dict[str, Any] = {}
    state: dict[str, Any] = {}
    instruction = ""
    for name, value in _flattened(given, "", 0):
        if isinstance(value, str):
            if name != PROMPT:
                raise InvalidInput(f"{name!r} is a str; valid is one only for {PROMPT!r}.")
            instruction = value
            continue
        array = np.asarray(value)
        if array.dtype == np.uint8 and array.ndim == 3:
            has_channels_first = array.shape[0] == 3 and array.shape[2] != 3
            images[name] = np.moveaxis(array, 0, 2) if has_channels_first else array
        elif array.dtype.kind in "fiub" and array.ndim <= 1:
            state[name] = np.atleast_1d(array)
        else:
            raise InvalidInput(
                f"{name!r} is {array.dtype} of shape {array.shape}; valid are images (height, width, 3) of uint8 and "
                "numbers (n,)."
            )
    return Observation(images=images, state=state, instruction=instruction, session=session, time=time)


def _array_to_map(array: NDArray[Any]) -> dict[bytes, Any]:
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b""
    return {b"__ndarray__": True, b"data": data, b"dtype": array.dtype.str, b"shape": array.shape}


def _number_to_map(number: np.generic) -> Any:
    return {b"__npgeneric__": True, b"data": number.item(), b"dtype": number.dtype.str}


def _from_map(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        return array_of(found.get(b"data"), found.get(b"dtype"), found.get(b"shape"))
    if b"__npgeneric__" in found:
        dtype, value = found.get(b"dtype"), found.get(b"data")
        if not isinstance(dtype, str) or dtype not in DTYPES or not isinstance(value, (int, float)):
            raise BadMessage(f"A number has the dtype {dtype!r:.40} and the value {value!r:.40}.")
        try:
            return np.dtype(dtype).type(value)
        except (OverflowError, ValueError) as error:
            raise BadMessage(f"{value!r:.40} is no {dtype}.") from error
    return found


def _flattened(given: object, prefix: str, depth: int) -> list[tuple[str, Any]]:
    if not isinstance(given, Mapping) or depth > DEEPEST:
        raise InvalidInput(f"An observation is a dictionary, with up to {DEEPEST} others inside each other.")
    found: list[tuple[str, Any]] = []
    for name, value in given.items():
        if not isinstance(name, str):
            raise InvalidInput(f"A key of the observation is {name!r:.80}; valid is a str.")
        if prefix == "" and name == OWN:
            continue
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            found += _flattened(value, f"{path}/", depth + 1)
        else:
            found.append((path, value))
    return found
