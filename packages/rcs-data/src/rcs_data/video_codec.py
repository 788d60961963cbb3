"""Encodes frames as packets of video, compares each with its source, and decodes packets.

Key frames are two apart and no frame refers to a later one, so a reader reaches any frame by decoding two, and packets
can be joined without encoding again. Every frame is decoded while it is written and compared with its source, block by
block: where a block is off (SVT-AV1 now and then leaves one of an earlier frame), the frame is encoded again as a key
frame.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from fractions import Fraction
from functools import cache
from itertools import chain
from typing import Any

import av
import numpy as np
from av.codec.context import Flags
from av.error import FFmpegError
from av.video.frame import PictureType
from av.video.reformatter import Interpolation, VideoReformatter
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.video_format import VideoCodec, pixel_format, stored_pixel_format

ENCODERS: dict[VideoCodec, str] = {"h264": "libx264", "av1": "libsvtav1"}
"""FFmpeg's names of the encoders."""
DECODERS: dict[VideoCodec, tuple[str, ...]] = {"h264": ("h264",), "av1": ("libdav1d", "av1")}
"""FFmpeg's names of the decoders; the first is used here."""
# One thread each, since episodes are encoded in parallel, and the result must not depend on the number of cores.
OPTIONS: dict[VideoCodec, dict[str, str]] = {
    "h264": {"preset": "superfast", "crf": "18", "g": "2", "bf": "0"},
    "av1": {"preset": "12", "crf": "30", "g": "2", "svtav1-params": "lp=1"},
}
"""Options of the encoders."""
# How frames that came out wrong are encoded once more, as key frames; a decoder needs no other parameters for them.
_MENDING: dict[VideoCodec, tuple[dict[str, str], ...]] = {
    "h264": ({"forced-idr": "1"}, {"forced-idr": "1", "qmin": "1", "qmax": "6"}),
    "av1": ({"g": "1"}, {"g": "1", "crf": "8"}),
}
# Packets, and their bytes, that are kept until they are compared: a long video takes no more memory than a short one.
_AT_A_TIME = 256
_BYTES_AT_A_TIME = 16 << 20
ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.partition(".")[0]) >= 17 else {}
"""Options of PyAV's `reformat`, which used one thread before it had a choice."""
_BLOCK = 16
# Mean squared error of a block, of 255: 25 dB. Without the bug, the worst of 1 354 frames had 30 dB.
LARGEST_ERROR = 255**2 / 10**2.5
"""Mean squared error of a block above which a frame is encoded again."""
# ITU-R BT.601 in limited range, FFmpeg's default for RGB and so what readers expect.
_BT601, _LIMITED = 5, 1
# FFmpeg's SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT: without the last two, colours come back 1.6 of 255 too
# dark on average.
_ACCURATE = 0x2 | 0x40000 | 0x2000
# Packets of an episode have no times; the encoder is told this rate [Hz].
_RATE = 30
# A decoder rounds sizes up to blocks of at most this [px].
_LARGEST_BLOCK = 128


def encode_clip(
    images: Iterable[NDArray[np.uint8]], shape: tuple[int, ...], codec: VideoCodec
) -> list[tuple[bytes, bool] | None]:
    """Return for each image its packet and whether it is a key frame; None where every try differs too much.

    Each key frame can be decoded alone, and each other frame after the packet before it, which is a key frame.

    Args:
        images: RGB, (H, W, 3) uint8.
        shape: The shape of each.
        codec: How they are compressed.

    Raises:
        DatasetError: The encoder fails.
    """
    encoder: Any = av.CodecContext.create(ENCODERS[codec], "w")
    encoder.options = OPTIONS[codec]
    encoder.time_base, encoder.framerate = Fraction(1, _RATE), Fraction(_RATE)
    format_ = stored_pixel_format(shape[0], shape[1], codec)
    prepare_encoder(encoder, shape, format_)
    clip: list[tuple[bytes, bool] | None] = []
    try:
        for packets, wrong in encoded_in_parts(encoder, codec, yuv_frames(images, format_, _RATE)):
            clip += [None if n in wrong else (bytes(p), p.is_keyframe) for n, p in enumerate(packets)]
    except FFmpegError as err:
        raise DatasetError(f"Cannot encode {shape[1]} x {shape[0]} pixels as {codec}: {err}.") from err
    return clip


def yuv_frames(images: Iterable[NDArray[Any]], format_: str, fps: int) -> Iterator[av.VideoFrame]:
    """Yield images in a pixel format, numbered from 0 in units of 1 / fps."""
    reformatter = VideoReformatter()  # one for all frames, and one thread: each frame's own would start several
    for number, image in enumerate(images):
        rgb = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="rgb24")
        frame = reformatter.reformat(rgb, format=format_, interpolation=Interpolation.AREA, **ONE_THREAD)
        frame.pts, frame.time_base = number, Fraction(1, fps)
        yield frame


def rgb_image(frame: av.VideoFrame, reformatter: VideoReformatter) -> NDArray[np.uint8]:
    """Return a decoded frame as RGB, (H, W, 3) uint8."""
    rgb = reformatter.reformat(frame, format="rgb24", interpolation=_ACCURATE, **ONE_THREAD)
    return np.asarray(rgb.to_ndarray(), np.uint8)


def encoded_in_parts(
    encoder: Any, codec: VideoCodec, frames: Iterable[av.VideoFrame]
) -> Iterator[tuple[list[Any], dict[int, av.VideoFrame]]]:
    """Yield packets, part by part from a key frame on, and by number in the part the frames that stay wrong.

    Args:
        encoder: Its context, prepared.
        codec: What it makes.
        frames: Its frames.

    Raises:
        DatasetError: The encoder fails.
    """
    packets: list[Any] = []
    size = 0
    wrong: dict[int, av.VideoFrame] = {}

    def mended() -> tuple[list[Any], dict[int, av.VideoFrame]]:
        left = wrong
        for options in _MENDING[codec]:
            left = _mended(packets, left, encoder, codec, options)
        return packets, left

    for frame, packet, is_right in _encoded(encoder, codec, frames):
        if packet.is_keyframe and (len(packets) >= _AT_A_TIME or size >= _BYTES_AT_A_TIME):
            yield mended()
            packets, size, wrong = [], 0, {}
        # The frame after a key frame that is encoded again refers to the old one.
        if not is_right or (not packet.is_keyframe and len(packets) - 1 in wrong):
            wrong[len(packets)] = frame
        packets.append(packet)
        size += packet.size
    yield mended()


def open_decoder(shape: tuple[int, ...], codec: VideoCodec) -> Any:
    """Return a decoder of packets with their own headers, which refuses larger images than those of a shape."""
    decoder: Any = av.CodecContext.create(DECODERS[codec][0], "r")
    most = (shape[0] + _LARGEST_BLOCK) * (shape[1] + _LARGEST_BLOCK)
    decoder.thread_count, decoder.options = 1, {"err_detect": "crccheck+explode", "max_pixels": str(most)}
    return decoder


def decode_packet(decoder: Any, packet: bytes, shape: tuple[int, ...], codec: VideoCodec) -> av.VideoFrame:
    """Return the frame of a packet; of one that is no key frame after the packet before it.

    Raises:
        CorruptEpisode: It does not decode to one frame of this shape.
    """
    try:
        (frame,) = decoder.decode(av.Packet(packet))
    except (FFmpegError, ValueError) as err:
        raise CorruptEpisode(f"The {len(packet)} bytes of {codec} do not decode to an image: {err}.") from err
    formats = stored_pixel_format(shape[0], shape[1], codec), pixel_format(shape[0], shape[1], codec)
    if (frame.height, frame.width) != shape[:2] or frame.format.name not in formats:
        raise CorruptEpisode(f"The image is {frame.height} x {frame.width} {frame.format.name}; expected {shape}.")
    return frame


def _encoded(
    encoder: Any, codec: VideoCodec, frames: Iterable[av.VideoFrame]
) -> Iterator[tuple[av.VideoFrame, Any, bool]]:
    """Yield each frame, its packet, and whether it decodes to what it was."""
    decoder: Any = av.CodecContext.create(DECODERS[codec][0], "r")
    decoder.extradata = encoder.extradata
    decoder.thread_count = 1
    given: deque[av.VideoFrame] = deque()
    packets: deque[Any] = deque()
    for frame in chain(frames, [None]):
        if frame is not None:
            given.append(frame)
        made = encoder.encode(frame)
        packets += made
        for packet in [*made, *([None] if frame is None else [])]:
            for shown in decoder.decode(packet):
                source = given.popleft()
                yield source, packets.popleft(), _largest_error(source, shown) <= LARGEST_ERROR
    if given or packets:
        raise DatasetError(f"{codec} made {len(packets)} packets more than frames, or lost {len(given)} frames.")


def _mended(
    packets: list[Any], wrong: Mapping[int, av.VideoFrame], first: Any, codec: VideoCodec, options: dict[str, str]
) -> dict[int, av.VideoFrame]:
    """Encode frames again as key frames, put them into the list, and return those that are still wrong."""
    if not wrong:
        return {}
    encoder: Any = av.CodecContext.create(ENCODERS[codec], "w")
    encoder.options = {**OPTIONS[codec], **options}
    encoder.time_base, encoder.framerate = first.time_base, first.framerate
    encoder.flags |= first.flags & int(Flags.global_header)
    prepare_encoder(encoder, (first.height, first.width), first.pix_fmt)
    if bytes(encoder.extradata or b"") != bytes(first.extradata or b""):
        return dict(wrong)
    for frame in wrong.values():
        frame.pict_type = PictureType.I
    left: dict[int, av.VideoFrame] = {}
    for number, (frame, packet, is_right) in zip(wrong, _encoded(encoder, codec, wrong.values()), strict=True):
        packets[number] = packet
        if not (is_right and packet.is_keyframe):
            left[number] = frame
    return left


def prepare_encoder(encoder: Any, shape: tuple[int, ...], format_: str) -> None:
    """Open an encoder for images of a shape, (H, W, …), and a pixel format."""
    encoder.height, encoder.width, encoder.pix_fmt = *shape[:2], format_
    encoder.thread_count = 1
    encoder.colorspace, encoder.color_range = _BT601, _LIMITED
    os.environ.setdefault("SVT_LOG", "1")  # otherwise it prints thirty lines per video
    _open_quietly(encoder)


def _largest_error(one: av.VideoFrame, other: av.VideoFrame) -> float:
    """Return the largest mean squared difference of a block of 16 x 16 values, over all planes."""
    return max(block_error(_values(a), _values(b)) for a, b in zip(one.planes, other.planes, strict=True))


def block_error(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    """Return the largest mean squared difference of a block of 16 x 16 values, shape (rows, columns).

    It is 0 where no value differs by more than the square root of `LARGEST_ERROR`.
    """
    difference = np.maximum(one, other) - np.minimum(one, other)
    if int(difference.max(initial=0)) ** 2 <= LARGEST_ERROR:
        return 0.0
    squares = np.square(difference, dtype=np.float32)
    down, across = (_block_sums(size) for size in squares.shape)
    return float((down @ squares @ across.T).max()) / _BLOCK**2


@cache
def _block_sums(size: int) -> NDArray[np.float32]:
    """Return the matrix that sums the values of each block, shape (blocks, size)."""
    return (np.arange(size) // _BLOCK == np.arange(-(-size // _BLOCK))[:, None]).astype(np.float32)


def _values(plane: Any) -> NDArray[np.uint8]:
    return np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]


def _open_quietly(codec: Any) -> None:
    """Open a codec, and take back the real-time priority that SVT-AV1 gives this thread and its own, where it may."""
    if not hasattr(os, "sched_getscheduler"):
        codec.open()
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    known = set(os.listdir("/proc/self/task"))
    codec.open()
    own = str(threading.get_native_id())
    for thread in os.listdir("/proc/self/task"):
        if thread == own or thread not in known:
            with suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(int(thread), policy, parameter)
