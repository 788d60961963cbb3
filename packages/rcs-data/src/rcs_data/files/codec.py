"""Images as the bytes of files: colour as JPEG or QOI, depth and labels as PNG.

Any viewer reads them.

Cost of 640 x 480 pixels of a simulated lab, with the noise of a real camera and without, on one core: QOI takes 4.6 and
2.3 ms to encode, 3.2 and 2.3 ms to decode, and 597 and 33 kB; by FFmpeg, PNG of the same image 11 to 13 and 2.6, 5 and
2.5 ms, and 507 and 29 kB. Depth as PNG takes 1.7 and 0.6, 2.7 and 1.1 ms, and 259 and 40 kB. FFmpeg takes six times as
long to encode it, and Pillow fourteen, in turns (0.44, 3.0 and 6.3 ms with noise, on another machine); hence the few
lines here.
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
from rcs_data.files.info import DatasetInfo

ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.partition(".")[0]) >= 17 else {}
"""Options of PyAV's `reformat`, which used one thread before it had a choice."""

PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file."""
_PNG_PIXELS = {(2, 2): "gray16be", (2, 1): "gray", (3, 1): "rgb24"}  # by axes and bytes per number
# How whole files begin and end; the last chunk of a PNG is empty, so its checksum never differs.
_JPEG, _QOI = (b"\xff\xd8", b"\xff\xd9"), (b"qoif", b"\0\0\0\0\0\0\0\1")
_PNG = (PNG, b"IEND\xaeB`\x82")


def encode_frame(feature: Feature, image: NDArray[Any], info: DatasetInfo) -> bytes:
    """Return the image as bytes, in the encoding of its feature.

    Args:
        feature: An image feature.
        image: An image of the feature's shape and dtype.
        info: For the quality of a JPEG.
    """
    if feature.encoding in ("depth", "labels"):
        return encode_png(image)
    if feature.encoding == "lossless":
        return encode_lossless(image)
    rgb = np.ascontiguousarray(image)
    return simplejpeg.encode_jpeg(rgb, info.jpeg_quality, "RGB", info.jpeg_subsampling, fastdct=False)


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
    if feature.encoding == "lossless":
        image = decode_lossless(data, feature.shape)
    else:
        image = decode_png(data, feature.shape, "uint16", converts=False)
    if out is None:
        return image
    out[...] = image
    return out


def is_file(feature: Feature, data: bytes) -> bool:
    """Return whether bytes begin and end like a file of an image feature's encoding; its pixels are not looked at."""
    return _is_whole(data, {"jpeg": _JPEG, "lossless": _QOI}.get(feature.encoding, _PNG))


def _is_whole(data: bytes, ends: tuple[bytes, bytes]) -> bool:
    return data.startswith(ends[0]) and data.endswith(ends[1])


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
    if not _is_whole(data, _JPEG):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole JPEG.")
    try:
        image = simplejpeg.decode_jpeg(data, "RGB", fastdct=False, fastupsample=False, strict=True, buffer=target)
    except ValueError as err:
        raise CorruptEpisode(f"The JPEG does not decode to {shape}: {err}.") from err
    if image.shape != shape:
        raise CorruptEpisode(f"The JPEG is {image.shape}; expected {shape}.")
    return image


def encode_lossless(image: NDArray[np.uint8]) -> bytes:
    """Return the image as a QOI file (https://qoiformat.org), which Pillow and FFmpeg read.

    Args:
        image: RGB, shape (H, W, 3).
    """
    context: Any = av.CodecContext.create("qoi", "w")
    context.height, context.width = image.shape[:2]
    context.pix_fmt, context.time_base, context.thread_count = "rgb24", Fraction(1), 1
    (packet,) = context.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24"))
    return bytes(packet)


def decode_lossless(data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the image in a QOI file.

    Args:
        data: The bytes of the file.
        shape: The expected shape, (H, W, 3).

    Raises:
        CorruptEpisode: The bytes are not a whole QOI file of this shape.
    """
    if not _is_whole(data, _QOI):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole QOI file.")
    return _decode("qoi", "rgb24", data, shape)


def encode_png(image: NDArray[Any]) -> bytes:
    """Return the image as PNG: depth [mm], labels, and colour for formats without another lossless encoding.

    Args:
        image: RGB, shape (H, W, 3), uint8; or grey, shape (H, W), uint8 or uint16.
    """
    # ISA-L deflates four times as fast as zlib, which FFmpeg uses, and as well.
    height, width = image.shape[:2]
    values = np.ascontiguousarray(image, image.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    lines = np.empty((height, 1 + values.shape[1]), np.uint8)
    lines[:, 0] = 2  # the filter "up": each byte minus that of the line before
    lines[0, 1:] = values[0]
    np.subtract(values[1:], values[:-1], out=lines[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, 2 if image.ndim == 3 else 0, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", isal_zlib.compress(lines, 1)), (b"IEND", b""))
    return PNG + b"".join(map(_chunk, *zip(*parts, strict=True)))


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
    if not _is_whole(data, _PNG):
        raise CorruptEpisode(f"The {len(data)} bytes are not a whole PNG file.")
    return _decode("png", _PNG_PIXELS[len(shape), np.dtype(dtype).itemsize], data, shape, converts=converts)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", isal_zlib.crc32(name + data))


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
