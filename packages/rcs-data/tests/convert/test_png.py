from __future__ import annotations

import io
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data.convert.png import encode_png


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (48, 64)])
@pytest.mark.parametrize(("dtype", "channels", "pixels"), [(np.uint8, (3,), "rgb24"), (np.uint16, (), "gray16le")])
def test_another_decoder_finds_every_pixel(shape: Any, dtype: Any, channels: Any, pixels: str) -> None:
    noise = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (*shape, *channels), dtype, endpoint=True)
    for image in (noise, np.zeros_like(noise), np.asfortranarray(noise), noise[::-1, ::-1]):
        np.testing.assert_array_equal(_decoded(encode_png(image), pixels), image)


def _decoded(data: bytes, pixels: str) -> NDArray[Any]:
    with av.open(io.BytesIO(data), format="png_pipe") as file:
        return next(file.decode(video=0)).to_ndarray(format=pixels)
