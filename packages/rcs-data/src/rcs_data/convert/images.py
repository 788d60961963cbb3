"""Images as files of other formats: recorded ones as PNG, and those of others as features store them."""

from __future__ import annotations

import io
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.files.codec import PNG, decode_frame, decode_jpeg, decode_png, encode_png
from rcs_data.files.feature import Feature

_JPEG = b"\xff\xd8"


def as_png(feature: Feature, data: bytes) -> bytes:
    """Return a recorded image as PNG: as it is, if it is stored so.

    Raises:
        CorruptEpisode: The bytes are not an image of the feature.
    """
    return data if data.startswith(PNG) else encode_png(decode_frame(feature, data))


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
    if data.startswith(PNG) and feature.encoding == "depth":
        decode_frame(feature, data)
        return data
    if data.startswith(PNG):
        return decode_png(data, feature.shape, feature.dtype)
    image = decode_image(data)
    if image.shape != feature.shape:
        raise CorruptEpisode(f"An image of {where} is {image.shape}; expected {feature.shape}.")
    return image


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
