"""Images as the bytes of files: colour as JPEG or QOI, depth and labels as PNG.

Any viewer reads them.

Cost of 640 x 480 pixels of a simulated lab, with the noise of a real camera and without, on one core: QOI takes 4.6 and
2.3 ms to encode, 3.2 and 2.3 ms to decode, and 597 and 33 kB; PNG of the same image 11 to 13 and 2.6, 5 and 2.5 ms, and
507 and 29 kB. Depth as PNG takes 1.7 and 0.6, 2.7 and 1.1 ms, and 259 and 40 kB. PyAV takes six times as long to encode
it, and Pillow fourteen, in turns (0.44, 3.0 and 6.3 ms with noise, on another machine); hence the few lines here.
"""

from __future__ import annotations

import math
import struct
from fractions import Fraction
from typing import Any

import av
import numpy as np
import simplejpeg
from av.error import FFmpegError
from isal import isal_zlib
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo, Subsampling

ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.partition(".")[0]) >= 17 else {}
"""Options of PyAV's `reformat`, which used one thread before it had a choice."""

PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file."""
_PNG_END = b"IEND"
_PNG_PIXELS = {(2, 2): "gray16be", (2, 1): "gray", (3, 1): "rgb24"}  # by axes and bytes per number
# Filter "sub", each byte minus that of the pixel before, and the fastest level that is not much larger.
_PNG_OPTIONS = {"compression_level": "1", "pred": "sub"}
_JPEG, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_QOI, _QOI_END = b"qoif", b"\0\0\0\0\0\0\0\1"


def encode_frame(feature: Feature, image: NDArray[Any], info: DatasetInfo) -> bytes:
    """Return the image as bytes, in the encoding of its feature.

    Args:
        feature: An image feature.
        image: An image of the feature's shape and dtype.
        info: For the quality of a JPEG.
    """
    if feature.encoding in ("depth", "labels"):
        return encode_depth(image)
    if feature.encoding == "lossless":
        return encode_lossless(image)
    return encode_jpeg(image, info.jpeg_quality, info.jpeg_subsampling)


def decode_frame(feature: Feature, data: bytes, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return the image in the bytes of a feature.

    Args:
        feature: An image feature.
        data: The bytes as stored.
        out: Where to put it: contiguous, with the feature's shape and dtype; None for a new
            array.

    Raises:
        CorruptEpisode: The bytes are not an image of the feature's shape.
    """
    if feature.encoding == "jpeg":
        return decode_jpeg(data, feature.shape, out)
    decode = decode_lossless if feature.encoding == "lossless" else decode_depth
    image = decode(data, feature.shape)
    if out is None:
        return image
    out[...] = image
    return out


def is_file(feature: Feature, data: bytes) -> bool:
    """Return whether bytes begin and end like a file of an image feature's encoding; its pixels are not looked at."""
    return {"jpeg": _is_jpeg, "lossless": _is_qoi}.get(feature.encoding, _is_png)(data)


def _is_jpeg(data: bytes) -> bool:
    return data[:2] == _JPEG and data[-2:] == _JPEG_END


def _is_qoi(data: bytes) -> bool:
    return data[:4] == _QOI and data[-8:] == _QOI_END


def _is_png(data: bytes) -> bool:
    return data[:8] == PNG and data[-8:-4] == _PNG_END


def blank_frame(feature: Feature, info: DatasetInfo) -> bytes:
    """Return a black image as bytes: what rows have before the first image."""
    return encode_frame(feature, np.zeros(feature.shape, feature.numpy_dtype), info)


def pixel_buffer(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return an empty array, laid out so that JPEGs decode into it fastest.

    libjpeg-turbo bypasses the processor's cache where a line begins at a multiple of 32 bytes. Since images are used
    right away, that costs time: 175 instead of 140 µs for 224 x 224 pixels. Here lines begin 16 bytes off.

    Args:
        shape: The shape of the image, (H, W, 3).
    """
    size = math.prod(shape)
    memory = np.empty(size + 32, np.uint8)
    start = (16 - memory.ctypes.data) % 32
    return memory[start : start + size].reshape(shape)


def encode_jpeg(image: NDArray[np.uint8], quality: int, subsampling: Subsampling) -> bytes:
    """Return the image as JPEG.

    Args:
        image: RGB, shape (H, W, 3).
        quality: 1 to 100.
        subsampling: How much colour is kept.
    """
    return simplejpeg.encode_jpeg(np.ascontiguousarray(image), quality, "RGB", subsampling, fastdct=False)


def decode_jpeg(data: bytes, shape: tuple[int, ...], out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Return the image in a JPEG.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W, 3).
        out: Where to put it, contiguous; None for a new array.

    Raises:
        CorruptEpisode: The bytes are no JPEG, end too early, or have another shape.
    """
    target = pixel_buffer(shape) if out is None else out
    # The decoder itself takes a file that was cut short and fills the rest with grey.
    if not _is_jpeg(data):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole JPEG.")
    try:
        image = simplejpeg.decode_jpeg(data, "RGB", fastdct=False, fastupsample=False, strict=True, buffer=target)
    except ValueError as err:
        raise CorruptEpisode(f"The JPEG does not decode to {shape}: {err}.") from err
    if image.shape != shape:
        raise CorruptEpisode(f"The JPEG is {image.shape}; expected {shape}.")
    return image


def decode_small_jpeg(data: bytes, least_height: int) -> NDArray[np.uint8]:
    """Return the image in a JPEG, reduced by the decoder where it can; good enough to look at.

    Args:
        data: The bytes of the file.
        least_height: Minimal height of the result [px].

    Raises:
        CorruptEpisode: The bytes are no JPEG.
    """
    try:
        return simplejpeg.decode_jpeg(data, "RGB", fastdct=True, fastupsample=True, min_height=least_height)
    except ValueError as err:
        raise CorruptEpisode(f"The JPEG does not decode: {err}.") from err


def encode_lossless(image: NDArray[np.uint8]) -> bytes:
    """Return the image as a QOI file (https://qoiformat.org), which Pillow and FFmpeg read.

    Args:
        image: RGB, shape (H, W, 3).
    """
    return _encode("qoi", "rgb24", image, {})


def decode_lossless(data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the image in a QOI file.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W, 3).

    Raises:
        CorruptEpisode: The bytes are not a whole QOI file of this shape.
    """
    if not _is_qoi(data):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole QOI file.")
    return _decode("qoi", "rgb24", data, shape)


def encode_depth(image: NDArray[np.uint16]) -> bytes:
    """Return the image as a PNG file of 16 bits.

    Args:
        image: Shape (H, W), millimetres or labels.
    """
    # ISA-L deflates four times as fast as zlib, which FFmpeg uses, and as well.
    height, width = image.shape
    values = image.astype(">u2").view(np.uint8).reshape(height, 2 * width)
    lines = np.empty((height, 1 + 2 * width), np.uint8)
    lines[:, 0] = 2  # the filter "up": each byte minus that of the line before
    lines[0, 1:] = values[0]
    np.subtract(values[1:], values[:-1], out=lines[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", isal_zlib.compress(lines, 1)), (_PNG_END, b""))
    return PNG + b"".join(map(_chunk, *zip(*parts, strict=True)))


def decode_depth(data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint16]:
    """Return the image in a PNG file of 16 bits.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W).

    Raises:
        CorruptEpisode: The bytes are not a whole PNG file of 16 bits and this shape.
    """
    return decode_png(data, shape, "uint16", converts=False)


def encode_png(image: NDArray[Any]) -> bytes:
    """Return the image as PNG, for formats without another lossless encoding.

    Args:
        image: RGB, shape (H, W, 3), uint8; or grey, shape (H, W), uint8 or uint16.
    """
    return _encode("png", _PNG_PIXELS[image.ndim, image.dtype.itemsize], image, _PNG_OPTIONS)


def decode_png(data: bytes, shape: tuple[int, ...], dtype: str, *, converts: bool = True) -> NDArray[Any]:
    """Return the image in a PNG file.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W) or (H, W, 3).
        dtype: "uint8" or "uint16".
        converts: Whether other pixels, such as those of a palette, become the expected ones.

    Raises:
        CorruptEpisode: The bytes are not such an image.
    """
    # The decoder itself takes a file that was cut short.
    if not _is_png(data):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole PNG file.")
    return _decode("png", _PNG_PIXELS[len(shape), np.dtype(dtype).itemsize], data, shape, converts=converts)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", isal_zlib.crc32(name + data))


def _encode(codec: str, pixels: str, image: NDArray[Any], options: dict[str, str]) -> bytes:
    context: Any = av.CodecContext.create(codec, "w")
    context.height, context.width = image.shape[:2]
    context.pix_fmt, context.time_base, context.thread_count, context.options = pixels, Fraction(1), 1, options
    (packet,) = context.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=pixels))
    return bytes(packet)


def _decode(codec: str, pixels: str, data: bytes, shape: tuple[int, ...], *, converts: bool = False) -> NDArray[Any]:
    # A new context for each image: one that decodes a second PNG returns wrong pixels.
    context: Any = av.CodecContext.create(codec, "r")
    context.thread_count, context.options = 1, {"err_detect": "crccheck+explode"}
    try:
        (frame,) = context.decode(av.Packet(data))
        image: NDArray[Any] = frame.to_ndarray(format=pixels) if converts else frame.to_ndarray()
    except (FFmpegError, ValueError) as err:
        raise CorruptEpisode(f"The {len(data)} bytes do not decode to {shape}: {err}.") from err
    if (frame.format.name != pixels and not converts) or image.shape != shape:
        raise CorruptEpisode(f"The image is {image.shape} {frame.format.name}; expected {shape} {pixels}.")
    return image
