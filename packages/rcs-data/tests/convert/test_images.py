from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data.convert.images import decode_image
from rcs_data.errors import CorruptEpisode
from rcs_data.files.codec import decode_png, encode_png


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (48, 64)])
@pytest.mark.parametrize(("dtype", "channels", "pixels"), [(np.uint8, (3,), "rgb24"), (np.uint16, (), "gray16le")])
def test_another_decoder_finds_every_pixel(shape: Any, dtype: Any, channels: Any, pixels: str) -> None:
    noise = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (*shape, *channels), dtype, endpoint=True)
    for image in (noise, np.zeros_like(noise), np.asfortranarray(noise), noise[::-1, ::-1]):
        data = encode_png(image)
        np.testing.assert_array_equal(_decoded(data, pixels), image)
        np.testing.assert_array_equal(decode_png(data, image.shape, image.dtype.name), image)
        assert decode_image(data).shape[:2] == image.shape[:2]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-20],
        lambda data: data[:40],
        lambda data: data[:5],
        lambda data: data[:60] + bytes([data[60] ^ 1]) + data[61:],
        lambda data: data[:16] + b"\x7f\xff\xff\xff" * 2 + data[24:],  # claims 2e9 x 2e9 pixels
        lambda data: b"GIF89a" + data,
    ],
)
def test_files_that_are_damaged_are_refused(damage: Callable[[bytes], bytes]) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (16, 24, 3), np.uint8)
    with pytest.raises(CorruptEpisode):
        decode_png(damage(encode_png(noise)), noise.shape, "uint8")


def test_files_of_any_kind_become_colour() -> None:
    given = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    np.testing.assert_array_equal(decode_image(encode_png(given)), given)
    with pytest.raises(CorruptEpisode, match="not an image"):
        decode_image(b"no image at all")


def _decoded(data: bytes, pixels: str) -> NDArray[Any]:
    with av.open(io.BytesIO(data), format="png_pipe") as file:
        return next(file.decode(video=0)).to_ndarray(format=pixels)
