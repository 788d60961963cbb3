"""PNG files, for formats without another lossless encoding."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _COLOUR = 0, 2
_FILTER_SUB = 1  # each byte minus that of the pixel before


def encode_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return the image as PNG.

    Args:
        image: RGB, shape (H, W, 3), uint8; or grey, shape (H, W), uint16.
    """
    height, width = image.shape[:2]
    colour, depth = (_COLOUR, 8) if image.ndim == 3 else (_GREY, 16)
    big_endian = np.ascontiguousarray(image, image.dtype.newbyteorder(">"))
    samples = big_endian.view(np.uint8).reshape(height, width, -1)
    lines = np.empty((height, 1 + samples[0].size), np.uint8)
    lines[:, 0] = _FILTER_SUB
    lines[:, 1:] = np.diff(samples, axis=1, prepend=np.uint8(0)).reshape(height, -1)  # wraps around, as PNG does
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    data = zlib.compress(lines.tobytes(), 1)
    return b"".join((_SIGNATURE, _chunk(b"IHDR", header), _chunk(b"IDAT", data), _chunk(b"IEND", b"")))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return b"".join((struct.pack(">I", len(data)), kind, data, struct.pack(">I", zlib.crc32(kind + data))))
