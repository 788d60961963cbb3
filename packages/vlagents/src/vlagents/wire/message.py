"""A message: plain values in a header, and the bytes of its arrays beside it, which are not copied.

The header is a dictionary in msgpack. An array in it is an extension of code 1 that holds `[dtype, shape, offset]`; its
bytes lie at that offset of the body. Nothing in a message is code, and nothing is imported because of one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import msgpack
from numpy.typing import NDArray

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


def pack(values: dict[str, Any]) -> tuple[bytes, list[memoryview], int]:
    """Split values into a header and the arrays' bytes.

    Args:
        values: Dictionaries with str as keys, lists, str, bytes, numbers, None and NumPy arrays.

    Returns:
        The header, the parts of the body with the padding between them, and the body's length [bytes].

    Raises:
        InvalidInput: A value does not travel.
    """
    parts: list[memoryview] = []
    end = 0

    def extension(array: NDArray[Any]) -> msgpack.Ext:
        nonlocal end
        array = np.ascontiguousarray(array).reshape(array.shape)
        if gap := -end % ALIGNMENT:
            parts.append(memoryview(bytes(gap)))
        start = end + gap
        if array.nbytes:
            parts.append(array.reshape(-1).view(np.uint8).data)
        end = start + array.nbytes
        return msgpack.Ext(ARRAY, msgpack.encode([array.dtype.str, array.shape, start]))

    header = encode(values, extension)
    return header, parts, end


def encode(
    values: Any,
    of_array: Callable[[NDArray[Any]], Any],
    of_number: Callable[[np.generic], Any] = lambda number: number.item(),
) -> bytes:
    """Return values as msgpack.

    Args:
        values: Plain values and NumPy arrays and numbers.
        of_array: Returns the plain values that stand for an array.
        of_number: Returns the plain values that stand for a number of NumPy; by default the number.

    Raises:
        InvalidInput: A value does not travel.
    """

    def hook(value: object) -> Any:
        if not isinstance(value, (np.ndarray, np.generic)):
            raise InvalidInput(f"{type(value).__name__} does not travel; valid are plain values and NumPy arrays.")
        if value.dtype.str not in DTYPES:
            raise InvalidInput(f"An array of dtype {value.dtype} does not travel; valid: {', '.join(sorted(DTYPES))}.")
        return of_array(value) if isinstance(value, np.ndarray) else of_number(value)

    try:
        return msgpack.encode(values, enc_hook=hook)
    except InvalidInput:
        raise
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidInput(f"This does not travel: {error}.") from error


def unpack(header: bytes | bytearray | memoryview, body: Any) -> dict[str, Any]:
    """Put a message together again; its large arrays are views of the body, small ones are copies.

    Args:
        header: The header that `pack` made of the values.
        body: A buffer with the bytes of the arrays.

    Raises:
        BadMessage: The two are no message.
    """
    size = len(body)
    raw = np.frombuffer(body, np.uint8) if size else np.zeros(0, np.uint8)
    total = 0

    def extension(code: int, data: memoryview) -> Any:
        nonlocal total
        if code != ARRAY:
            raise BadMessage(f"The header has an extension of code {code}; valid is {ARRAY}.")
        described = msgpack.decode(data)
        if not (isinstance(described, list) and len(described) == 3 and _is_whole(described[2])):
            raise BadMessage("An array is not described by [dtype, shape, offset].")
        dtype, shape, offset = described
        length = bytes_of(dtype, shape)
        if offset + length > size:
            raise BadMessage(f"An array of {length} bytes at {offset} does not lie in a body of {size} bytes.")
        total += length
        if total > size:  # or a short header could have the same bytes be copied any number of times
            raise BadMessage(f"The arrays have more than the {size} bytes of the body: some lie in others.")
        array = array_of(raw[offset : offset + length], dtype, shape)
        # A small array that is kept does not keep the whole body.
        return array if length >= SMALL else array.copy()

    try:
        return msgpack.decode(header, type=dict[str, Any], ext_hook=extension)
    except BadMessage:
        raise
    except Exception as error:  # whatever msgspec raises for other bytes
        raise BadMessage(f"The header is no msgpack: {type(error).__name__}: {error}.") from error


def bytes_of(dtype: object, shape: object) -> int:
    """Return how many bytes an array has.

    Raises:
        BadMessage: Such an array does not travel.
    """
    if not isinstance(dtype, str) or dtype not in DTYPES:
        raise BadMessage(f"An array has the dtype {dtype!r:.40}; valid: {', '.join(sorted(DTYPES))}.")
    if not isinstance(shape, list) or len(shape) > MOST_AXES or not all(_is_whole(n) for n in shape):
        raise BadMessage(f"An array has the shape {shape!r:.80}; valid are up to {MOST_AXES} whole numbers from 0.")
    return math.prod(shape) * np.dtype(dtype).itemsize


def array_of(data: object, dtype: object, shape: object) -> NDArray[Any]:
    """Return the array that lies in a buffer: a copy of bytes, so that it can be written, and a view of others.

    Raises:
        BadMessage: Such an array does not travel, or this is no buffer, or one of another length.
    """
    if not isinstance(data, (bytes, memoryview, np.ndarray)):
        raise BadMessage(f"An array has {type(data).__name__} as data; valid are bytes.")
    length = bytes_of(dtype, shape)
    if len(data) != length:
        raise BadMessage(f"An array of shape {shape} has {len(data)} bytes of {dtype}; valid are {length}.")
    axes: Any = shape
    kind = np.dtype(str(dtype))
    try:
        array = np.frombuffer(data, kind).reshape(axes) if length else np.zeros([min(n, 1 << 31) for n in axes], kind)
    except ValueError as error:
        raise BadMessage(f"An array has the shape {shape}: {error}.") from error
    return array.copy() if isinstance(data, bytes) else array


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48
