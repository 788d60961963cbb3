"""openpi's messages: one msgpack per observation and per answer, arrays inside it as bytes.

Layout as in openpi's `msgpack_numpy.py`: an array is a map with the bytes `__ndarray__`, `data`, `dtype`, `shape` as
keys, a NumPy scalar one with `__npgeneric__`, `data`, `dtype`. A flat dictionary of arrays and `prompt` goes there;
`actions`, (horizon, size), come back.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, InvalidInput
from vlagents.observation import Observation
from vlagents.wire import bulk
from vlagents.wire.bulk import LARGE
from vlagents.wire.message import DTYPES, MOST_AXES

OWN = "vlagents"
"""Key of what openpi does not have: session, times, and calls other than for actions. Both sides of ours use it."""
PROMPT = "prompt"
ACTIONS = "actions"
ARRAY_HEAD = b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data"
"""How an array begins."""
DEEPEST = 4
"""Most dictionaries inside each other."""


def pack(values: Any) -> bytes:
    """Return values as openpi sends them.

    Raises:
        InvalidInput: Something among them does not travel.
    """
    try:
        data: Any = msgpack.packb(values, default=_to_map)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(f"This does not travel: {error}") from error
    return data


def pack_parts(values: Mapping[str, Any]) -> list[bytes | memoryview]:
    """Return values as openpi sends them, in parts: large arrays of the outermost dictionary are not copied.

    Raises:
        InvalidInput: Something among them does not travel.
    """
    parts: list[bytes | memoryview] = []
    small = [msgpack.Packer().pack_map_header(len(values))]
    for name, value in values.items():
        small.append(pack(name))
        if isinstance(value, np.ndarray) and value.nbytes >= LARGE:
            as_map = _to_map(value)
            data = as_map[b"data"]
            parts += [b"".join([*small, ARRAY_HEAD, struct.pack(">BI", 0xC6, len(data))]), data]
            small = [pack(b"dtype"), pack(as_map[b"dtype"]), pack(b"shape"), pack(as_map[b"shape"])]
        else:
            small.append(pack(value))
    return [*parts, b"".join(small)]


def unpack(data: bytes | memoryview) -> Any:
    """Read what openpi sent. Large arrays lie in the data; all can be written if the data can.

    Raises:
        BadMessage: It is none of its messages, or what is no large array has more than `LARGEST_HEADER` bytes.
    """
    return bulk.unpack(data, _from_map)


def observation_to_flat(observation: Observation) -> dict[str, Any]:
    """Return an observation as a flat dictionary, with the names of images and parts as keys.

    Raises:
        InvalidInput: It has what openpi does not know: compressed pictures or goals.
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
    """Read an observation: bytes with three axes are pictures, numbers with one are state, `prompt` is the instruction.

    Dictionaries inside become names with a slash between; pictures with the channels first are turned.

    Raises:
        InvalidInput: Something is none of these.
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
                f"{name!r} is {array.dtype} of shape {array.shape}; valid are pictures (height, width, 3) of uint8 and "
                "numbers (n,)."
            )
    return Observation(images=images, state=state, instruction=instruction, session=session, time=time)


def chunk_from_flat(given: object, period: float, time: float) -> Chunk:
    """Read openpi's answer.

    Raises:
        BadMessage: It has no valid actions.
    """
    actions = given.get(ACTIONS) if isinstance(given, Mapping) else None
    if not isinstance(actions, np.ndarray):
        raise BadMessage(f"The answer has no array {ACTIONS!r}.")
    assert isinstance(given, Mapping)
    timing = given.get("server_timing")
    info = (
        {k: float(v) for k, v in timing.items() if isinstance(v, (int, float))} if isinstance(timing, Mapping) else {}
    )
    try:
        return Chunk(np.array(actions, np.float64).reshape(-1, actions.shape[-1]), period, time, info)
    except (InvalidInput, ValueError, IndexError) as error:
        raise BadMessage(f"The answer is no chunk: {error}") from error


def _to_map(value: object) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.str not in DTYPES:
            raise InvalidInput(f"An array of dtype {value.dtype} does not travel; valid: {', '.join(sorted(DTYPES))}.")
        data = np.ascontiguousarray(value).reshape(-1).view(np.uint8).data if value.size else b""
        return {b"__ndarray__": True, b"data": data, b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic):
        if value.dtype.str not in DTYPES:
            raise InvalidInput(f"A number of dtype {value.dtype} does not travel.")
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise InvalidInput(f"{type(value).__name__} does not travel; valid are plain values and NumPy arrays.")


def _from_map(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        data, dtype, shape = found.get(b"data"), found.get(b"dtype"), found.get(b"shape")
        if dtype not in DTYPES or not isinstance(data, (bytes, memoryview)):
            raise BadMessage(f"An array has the dtype {dtype!r:.40}; valid: {', '.join(sorted(DTYPES))}.")
        axes: list[Any] = list(shape) if isinstance(shape, (list, tuple)) else [None]
        if len(axes) > MOST_AXES or not all(type(n) is int and 0 <= n < 1 << 40 for n in axes):
            raise BadMessage(f"An array has the shape {shape!r:.80}; valid are up to {MOST_AXES} whole numbers from 0.")
        try:
            array = np.frombuffer(data, np.dtype(dtype)).reshape(axes)
            return array.copy() if isinstance(data, bytes) else array
        except ValueError as error:
            raise BadMessage(f"An array of shape {shape} has {len(data)} bytes of {dtype}: {error}.") from error
    if b"__npgeneric__" in found:
        dtype, value = found.get(b"dtype"), found.get(b"data")
        if dtype not in DTYPES or not isinstance(value, (int, float)):
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
