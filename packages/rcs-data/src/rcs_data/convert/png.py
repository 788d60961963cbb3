"""PNG files, for formats without another lossless encoding."""

from __future__ import annotations

import struct
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from rcs_data.codec import decode_frame
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file."""

_FORMATS = {(2, 2): "gray16be", (2, 1): "gray", (3, 1): "rgb24"}  # by axes and bytes per number
# Filter "sub", each byte minus that of the pixel before, and the fastest level that is not much larger.
_OPTIONS = {"compression_level": "1", "pred": "sub"}


def encode_png(image: NDArray[Any]) -> bytes:
    """Return the image as PNG.

    Args:
        image: RGB, shape (H, W, 3), uint8; or grey, shape (H, W), uint8 or uint16.
    """
    pixels = _FORMATS[image.ndim, image.dtype.itemsize]
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=pixels)
    codec: Any = av.CodecContext.create("png", "w")
    codec.width, codec.height, codec.pix_fmt, codec.options = frame.width, frame.height, pixels, _OPTIONS
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])


def as_png(feature: Feature, data: bytes) -> bytes:
    """Return a recorded image as PNG: as it is, if it is stored so.

    Raises:
        CorruptEpisode: The bytes are not an image of the feature.
    """
    return data if data.startswith(SIGNATURE) else encode_png(decode_frame(feature, data))


def png_shape(data: bytes | memoryview) -> tuple[int, ...]:
    """Return the shape that a PNG file claims, (H, W) or (H, W, channels), without decoding it.

    Raises:
        CorruptEpisode: It is not a PNG file.
    """
    if bytes(data[:8]) != SIGNATURE or bytes(data[12:16]) != b"IHDR" or len(data) < 33:
        raise CorruptEpisode(f"The {len(data)} bytes are not a PNG file.")
    width, height, _, kind = struct.unpack(">IIBB", data[16:26])
    channels = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(kind, 0)  # a palette has colours of three channels
    return (height, width) if channels == 1 else (height, width, channels)


def decode_png(data: bytes | memoryview, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """Return the image in a PNG file.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W) or (H, W, 3); a file can claim a larger one in a few bytes.
        dtype: "uint8" or "uint16".

    Raises:
        CorruptEpisode: The bytes are not such an image.
    """
    if png_shape(data)[:2] != shape[:2]:
        raise CorruptEpisode(f"The PNG is {png_shape(data)}; expected {shape}.")
    pixels = _FORMATS[len(shape), np.dtype(dtype).itemsize]
    codec: Any = av.CodecContext.create("png", "r")
    codec.options = {"err_detect": "crccheck+explode"}
    try:
        # The decoder itself takes a file that was cut short.
        if bytes(data[-8:-4]) != b"IEND":
            raise ValueError("it has no end")
        image = codec.decode(av.Packet(bytes(data)))[0].to_ndarray(format=pixels)
    except (FFmpegError, IndexError, ValueError) as err:
        raise CorruptEpisode(f"The PNG of {len(data)} bytes does not decode: {err!r}.") from err
    return image.astype(dtype, copy=False)
