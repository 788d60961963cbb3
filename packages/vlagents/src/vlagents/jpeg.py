"""A picture that stays compressed on its way, and the decoding of compressed pictures."""

from __future__ import annotations

import importlib
import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput

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
        """Return the picture as RGB, uint8, (height, width, 3).

        Raises:
            InvalidInput: It is damaged, or larger than 64 million pixels, or Pillow is not installed.
        """
        return decoded(self.data, "JPEG")


def decoded(data: bytes | memoryview, *formats: str) -> NDArray[np.uint8]:
    """Return the picture of a file as RGB, uint8, (height, width, 3); its size is checked before it is decompressed.

    Args:
        data: The bytes of the file.
        formats: Pillow's names of the formats that it may have.

    Raises:
        InvalidInput: It is damaged, or larger than 64 million pixels, or Pillow is not installed.
    """
    try:
        pillow = importlib.import_module("PIL.Image")
    except ImportError:
        raise InvalidInput("Pillow, which decodes pictures, is not installed; `pip install pillow`.") from None
    kind = " or ".join(formats)
    try:
        picture = pillow.open(io.BytesIO(data), formats=formats)
        size = f"{picture.height} x {picture.width} pixels"
        array = None if picture.height * picture.width > LARGEST else np.asarray(picture.convert("RGB"))
    except Exception as error:
        raise InvalidInput(f"A {kind} of {len(data)} bytes cannot be decoded: {error}.") from error
    if array is None:
        raise InvalidInput(f"A {kind} has {size}; valid are up to {LARGEST}.")
    return array
