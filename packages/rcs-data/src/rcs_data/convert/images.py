"""Images as files of other formats: PNG, for formats without another lossless encoding, and whatever PyAV reads."""

from __future__ import annotations

import io
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.files.codec import decode_frame, decode_jpeg
from rcs_data.files.feature import Feature

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file."""

_JPEG = b"\xff\xd8"
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


def as_stored(feature: Feature, data: bytes, where: str) -> bytes | NDArray[Any]:
    """Return an image file of another dataset as a feature stores it: as it is where that can be, else its pixels.

    Every file is decoded, so that damage is found by the import and not by a training.

    Args:
        feature: The feature that it becomes.
        data: The bytes of the file; zeros after a JPEG do not count.
        where: Where it is from, for messages.

    Raises:
        CorruptEpisode: The bytes are not such an image.
    """
    if data.startswith(_JPEG):
        data = data.rstrip(b"\0")
        image = decode_jpeg(data, feature.shape)
        return data if feature.encoding == "jpeg" else image
    if data.startswith(SIGNATURE) and feature.encoding == "depth":
        decode_frame(feature, data)
        return data
    if data.startswith(SIGNATURE):
        return decode_png(data, feature.shape, feature.dtype)
    image = decode_image(data)
    if image.shape != feature.shape:
        raise CorruptEpisode(f"An image of {where} is {image.shape}; expected {feature.shape}.")
    return image


def decode_png(data: bytes, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """Return the image in a PNG file.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W) or (H, W, 3).
        dtype: "uint8" or "uint16".

    Raises:
        CorruptEpisode: The bytes are not such an image.
    """
    codec: Any = av.CodecContext.create("png", "r")
    codec.options = {"err_detect": "crccheck+explode"}
    try:
        if data[-8:-4] != b"IEND":  # the decoder itself takes a file that was cut short
            raise ValueError("it has no end")
        frame = codec.decode(av.Packet(data))[0]
        image = frame.to_ndarray(format=_FORMATS[len(shape), np.dtype(dtype).itemsize])
    except (FFmpegError, IndexError, ValueError) as err:
        raise CorruptEpisode(f"The PNG of {len(data)} bytes does not decode: {err!r}.") from err
    if image.shape != shape:
        raise CorruptEpisode(f"The PNG is {image.shape}; expected {shape}.")
    return image.astype(dtype, copy=False)


def decode_image(data: bytes) -> NDArray[np.uint8]:
    """Return the image in the bytes of a PNG, JPEG or similar file, (H, W, 3) uint8 RGB.

    Raises:
        CorruptEpisode: The bytes are not an image.
    """
    try:
        with av.open(io.BytesIO(data), "r") as source:
            return np.asarray(next(source.decode(video=0)).to_ndarray(format="rgb24"), np.uint8)
    except (FFmpegError, StopIteration, IndexError) as err:
        raise CorruptEpisode(f"The {len(data)} bytes are not an image: {err!r}.") from err
