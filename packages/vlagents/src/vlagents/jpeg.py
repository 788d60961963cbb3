"""A picture that stays compressed on its way."""

from __future__ import annotations

import importlib
import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput, MissingStack

LARGEST = 64_000_000
"""Most pixels of a picture that is decompressed: a few bytes must not become gigabytes."""


@dataclass(frozen=True)
class Jpeg:
    """The bytes of a JPEG file."""

    data: bytes

    def __post_init__(self) -> None:
        """Check that it begins as a JPEG does.

        Raises:
            InvalidInput: It does not.
        """
        if bytes(self.data[:2]) != b"\xff\xd8":
            raise InvalidInput(f"A Jpeg begins with the bytes ff d8; this one has {bytes(self.data[:2]).hex(' ')!r}.")

    def decode(self) -> NDArray[np.uint8]:
        """Return the picture as RGB, uint8, (height, width, 3), by simplejpeg or Pillow, whichever is installed.

        Raises:
            InvalidInput: It is damaged, or larger than 64 million pixels.
            MissingStack: Neither package is installed.
        """
        try:
            decoder = importlib.import_module("simplejpeg")
        except ImportError:
            return self._decode_by_pillow()
        try:
            height, width, *_ = decoder.decode_jpeg_header(self.data)
            _check_size(height, width)
            return decoder.decode_jpeg(self.data, colorspace="RGB")
        except ValueError as error:
            raise InvalidInput(f"A Jpeg of {len(self.data)} bytes cannot be decoded: {error}.") from error

    def _decode_by_pillow(self) -> NDArray[np.uint8]:
        try:
            pillow = importlib.import_module("PIL.Image")
        except ImportError:
            raise MissingStack("jpeg", "simplejpeg") from None
        try:
            picture = pillow.open(io.BytesIO(self.data), formats=("JPEG",))
            _check_size(picture.height, picture.width)
            return np.asarray(picture.convert("RGB"))
        except InvalidInput:
            raise
        except Exception as error:
            raise InvalidInput(f"A Jpeg of {len(self.data)} bytes cannot be decoded: {error}.") from error


def _check_size(height: int, width: int) -> None:
    if height * width > LARGEST:
        raise InvalidInput(f"A Jpeg has {height} x {width} pixels; valid are up to {LARGEST}.")
