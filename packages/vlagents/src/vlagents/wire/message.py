"""A message: plain values in a header, and the bytes of its arrays beside it, which nobody copies.

The header is msgpack. An array in it is an extension of code 1 that holds `[dtype, shape, offset]`; its bytes lie at
that offset of the body. Nothing in a message is code, and nothing is imported because of one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgpack
import numpy as np

from vlagents.errors import BadMessage, InvalidInput

ARRAY = 1
"""Code of the extension that stands for an array."""
ALIGNMENT = 64
"""Arrays begin at multiples of this many bytes."""
DTYPES = frozenset({"|b1", "|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"})
"""Types of arrays that travel; all others are refused, objects above all."""
MOST_AXES = 8
SMALL = 64 << 10
"""Arrays of fewer bytes are copied out of a body [bytes]."""


def pack(values: Any) -> tuple[bytes, list[memoryview], int]:
    """Split values into a header and the arrays' bytes.

    Args:
        values: Dictionaries with str as keys, lists, str, bytes, numbers, None and NumPy arrays.

    Returns:
        The header, the parts of the body with the padding between them, and the body's length [bytes].

    Raises:
        InvalidInput: Something among them does not travel.
    """
    parts: list[memoryview] = []
    end = 0

    def extension(value: object) -> Any:
        nonlocal end
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value).reshape(value.shape)
            if array.dtype.str not in DTYPES:
                raise InvalidInput(
                    f"An array of dtype {array.dtype} does not travel; valid: {', '.join(sorted(DTYPES))}."
                )
            if gap := -end % ALIGNMENT:
                parts.append(memoryview(bytes(gap)))
            start = end + gap
            if array.nbytes:
                parts.append(array.reshape(-1).view(np.uint8).data)
            end = start + array.nbytes
            return msgpack.ExtType(ARRAY, msgpack.packb([array.dtype.str, list(array.shape), start]))
        if isinstance(value, (np.generic,)) and value.dtype.kind in "biuf":
            return value.item()
        raise InvalidInput(f"{type(value).__name__} does not travel; valid are plain values and NumPy arrays.")

    try:
        header: Any = msgpack.packb(values, default=extension)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"This does not travel: {error}.") from error
    return header, parts, end


def unpack(header: bytes | bytearray | memoryview, body: Any) -> Any:
    """Put a message together again; its large arrays are views of the body, small ones are copies.

    Args:
        header: What `pack` made of the values.
        body: A buffer with the bytes of the arrays.

    Raises:
        BadMessage: It is none.
    """
    size = len(body)
    raw = np.frombuffer(body, np.uint8) if size else np.zeros(0, np.uint8)
    total = 0

    def extension(code: int, data: bytes) -> Any:
        nonlocal total
        if code != ARRAY:
            raise BadMessage(f"The header has an extension of code {code}; valid is {ARRAY}.")
        described = msgpack.unpackb(data)
        if not (isinstance(described, list) and len(described) == 3):
            raise BadMessage("An array is not described by [dtype, shape, offset].")
        array = _view(raw, *described)
        total += array.nbytes
        if total > size:  # or a short header could have the same bytes be copied any number of times
            raise BadMessage(f"The arrays have more than the {size} bytes of the body: some lie in others.")
        # Whoever keeps a small one does not keep the whole body.
        return array if array.nbytes >= SMALL else array.copy()

    try:
        return msgpack.unpackb(header, ext_hook=extension, strict_map_key=True)
    except BadMessage:
        raise
    except Exception as error:  # whatever msgpack raises for what is no msgpack
        raise BadMessage(f"The header is no msgpack: {type(error).__name__}: {error}.") from error


def _view(raw: np.ndarray[Any, Any], dtype: object, shape: object, offset: object) -> np.ndarray[Any, Any]:
    if dtype not in DTYPES:
        raise BadMessage(f"An array has the dtype {dtype!r:.40}; valid: {', '.join(sorted(DTYPES))}.")
    if not _is_whole(offset):
        raise BadMessage(f"An array begins at {offset!r:.40}; valid is a whole number from 0.")
    if not isinstance(shape, list) or len(shape) > MOST_AXES or not all(_is_whole(n) for n in shape):
        raise BadMessage(f"An array has the shape {shape!r:.80}; valid are up to {MOST_AXES} whole numbers from 0.")
    kind = np.dtype(str(dtype))
    length = math.prod(shape) * kind.itemsize
    if offset + length > raw.size:  # type: ignore[operator]
        raise BadMessage(f"An array of {length} bytes at {offset} does not lie in a body of {raw.size} bytes.")
    if length == 0:
        return np.zeros([min(n, 1 << 31) for n in shape], kind) if math.prod(shape) == 0 else np.zeros(shape, kind)
    return raw[offset : offset + length].view(kind).reshape(shape)  # type: ignore[operator]


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48


def body_of(parts: Sequence[memoryview]) -> bytes:
    """Return the parts of a body as one."""
    return b"".join(parts)
