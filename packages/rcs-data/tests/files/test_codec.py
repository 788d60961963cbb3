"""Depth comes back bit for bit, colour nearly so, and what was cut short is refused."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rcs_data.errors import CorruptEpisode
from rcs_data.files.codec import decode_jpeg, decode_lossless, decode_png, encode_frame, encode_lossless, encode_png
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo, Subsampling


@settings(max_examples=50)
@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 2**32 - 1), st.sampled_from([1, 50, 65535]))
def test_depth_comes_back_bit_for_bit(height: int, width: int, seed: int, largest: int) -> None:
    image = np.random.default_rng(seed).integers(0, largest, (height, width), np.uint16, endpoint=True)
    np.testing.assert_array_equal(_depth(encode_png(image), image.shape), image)


@settings(max_examples=50)
@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 255]))
def test_lossless_colour_comes_back_bit_for_bit(height: int, width: int, seed: int, largest: int) -> None:
    image = np.random.default_rng(seed).integers(0, largest, (height, width, 3), np.uint8, endpoint=True)
    np.testing.assert_array_equal(decode_lossless(encode_lossless(image), image.shape), image)


def test_pillow_reads_what_is_stored() -> None:
    open_image = pytest.importorskip("PIL.Image").open
    rng = np.random.default_rng(0)
    colour, depth = rng.integers(0, 256, (12, 8, 3), np.uint8), rng.integers(0, 65536, (12, 8), np.uint16)
    np.testing.assert_array_equal(np.asarray(open_image(io.BytesIO(encode_lossless(colour)))), colour)
    np.testing.assert_array_equal(np.asarray(open_image(io.BytesIO(encode_png(depth)))), depth)


@pytest.mark.parametrize("place", [20, 45, -20])
def test_a_changed_byte_of_a_png_is_refused(place: int) -> None:
    data = bytearray(encode_png(np.arange(4000, dtype=np.uint16).reshape(40, 100)))
    data[place] ^= 1
    with pytest.raises(CorruptEpisode):
        _depth(bytes(data), (40, 100))


def test_a_view_of_a_larger_image_comes_back_too() -> None:
    image = np.arange(4000, dtype=np.uint16).reshape(40, 100)[::2, 10:50]
    np.testing.assert_array_equal(_depth(encode_png(image), image.shape), image)


def test_smooth_depth_takes_less_than_a_third_of_its_size() -> None:
    y, x = np.mgrid[:120, :160]
    image = (600 + 2 * y + x + np.random.default_rng(0).normal(0, 1, x.shape)).astype(np.uint16)
    assert len(encode_png(image)) < image.nbytes / 3


def test_colour_is_close_and_channels_are_not_swapped() -> None:
    y, x = np.mgrid[:48, :64]
    image = np.stack([4 * x, 5 * y, 0 * x], axis=-1).astype(np.uint8)
    decoded = decode_jpeg(_jpeg(image), image.shape)
    assert np.abs(decoded.astype(int) - image).max() <= 8


@pytest.mark.parametrize("cut", [0, 1, 3, 100, -2])
def test_an_image_that_was_cut_short_is_refused(cut: int) -> None:
    image = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    with pytest.raises(CorruptEpisode):
        decode_jpeg(_jpeg(image)[:cut], image.shape)
    with pytest.raises(CorruptEpisode):
        _depth(encode_png(image[..., 0].astype(np.uint16))[:cut], (32, 32))
    with pytest.raises(CorruptEpisode):
        decode_lossless(encode_lossless(image)[:cut], image.shape)


def test_an_image_of_another_shape_is_refused() -> None:
    with pytest.raises(CorruptEpisode, match="expected"):
        decode_jpeg(_jpeg(np.zeros((8, 8, 3), np.uint8)), (8, 16, 3))
    with pytest.raises(CorruptEpisode):
        _depth(encode_png(np.zeros((8, 8), np.uint16)), (8, 16))
    with pytest.raises(CorruptEpisode, match="expected"):
        decode_lossless(encode_lossless(np.zeros((8, 8, 3), np.uint8)), (8, 16, 3))


@pytest.mark.parametrize("size", [(16, 24), (15, 23), (224, 224), (1, 1)])
def test_where_a_jpeg_is_decoded_to_changes_nothing(size: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    data = _jpeg(image, 90, "420")
    own = decode_jpeg(data, image.shape)
    assert own.flags.c_contiguous
    assert own.ctypes.data % 32 == 16
    for start in range(0, 64, 8):
        memory = np.zeros(image.nbytes + 128, np.uint8)
        out = memory[start : start + image.nbytes].reshape(image.shape)
        assert decode_jpeg(data, image.shape, out).ctypes.data == out.ctypes.data
        np.testing.assert_array_equal(out, own)
        assert not memory[start + image.nbytes :].any()  # nothing beyond it
    for other in ((size[0] + 1, size[1], 3), (size[0], size[1] + 1, 3), (1000, 1000, 3)):
        with pytest.raises(CorruptEpisode):
            decode_jpeg(data, other)


def _jpeg(image: NDArray[np.uint8], quality: int = 95, subsampling: Subsampling = "444") -> bytes:
    feature = Feature(key="observation/frames/a/rgb", shape=image.shape, dtype="uint8", encoding="jpeg")
    info = DatasetInfo(frequency=30.0, features=(feature,), setup={}, instruction="")
    return encode_frame(feature, image, replace(info, jpeg_quality=quality, jpeg_subsampling=subsampling))


def _depth(data: bytes, shape: tuple[int, ...]) -> NDArray[Any]:
    return decode_png(data, shape, "uint16", converts=False)
