"""Writes and reads videos with exact frames at exact times.

Frame n is stamped n / fps, never with the wall clock, since trainers look frames up by time. Key frames are two apart
and no frame refers to a later one, so a reader reaches any frame by decoding two, and videos can be joined without
encoding again. Every frame is decoded while it is written and compared with its source, block by block: where a block
is off (SVT-AV1 now and then leaves one of an earlier frame), the frame is encoded again as a key frame.

Measured on 1 354 frames of 224 x 224 pixels of a simulated lab, one core of a busy machine, comparison included: H.264
("superfast", CRF 18) 1050 frames/s, 2.3 kB a frame, worst block 31.9 dB; AV1 (preset 12, CRF 30, as LeRobot's own) 380
frames/s, 1.5 kB, worst block 25.0 dB (20.6 dB, were no frame encoded again). Both halve the resolution of colour
(4:2:0), which is most of the error.
"""

from __future__ import annotations

import io
import os
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from fractions import Fraction
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.codec.context import Flags
from av.error import FFmpegError
from av.video.frame import PictureType
from av.video.reformatter import Interpolation, VideoReformatter
from numpy.typing import NDArray

from rcs_data.convert.options import VideoCodec
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup

_ENCODERS = {"h264": "libx264", "av1": "libsvtav1"}
_DECODERS = {"h264": "h264", "av1": "libdav1d"}
# One thread each, since episodes are encoded in parallel, and the result must not depend on the number of cores.
_OPTIONS: dict[str, dict[str, str]] = {
    "h264": {"preset": "superfast", "crf": "18", "g": "2", "bf": "0"},
    "av1": {"preset": "12", "crf": "30", "g": "2", "svtav1-params": "lp=1"},
}
# How frames that came out wrong are encoded once more, as key frames; a decoder needs no other parameters for them.
_MENDING: dict[str, tuple[dict[str, str], ...]] = {
    "h264": ({"forced-idr": "1"}, {"forced-idr": "1", "qmin": "1", "qmax": "6"}),
    "av1": ({"g": "1"}, {"g": "1", "crf": "8"}),
}
# Packets that are kept until they are compared, so that a long video takes no more memory than a short one.
_AT_A_TIME = 256
_BLOCK = 16
# Mean squared error of a block, of 255: 25 dB. Without the bug, the worst of 1 354 frames had 30 dB.
_LARGEST_ERROR = 255**2 / 10**2.5
# Without it, every Matroska file gets a random number.
_REPRODUCIBLE = {"fflags": "+bitexact"}
# SVT-AV1 refuses anything smaller.
_SMALLEST_AV1 = 64
# ITU-R BT.601 in limited range, FFmpeg's default for RGB and so what readers expect.
_BT601, _LIMITED = 5, 1
# FFmpeg's SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT: without the last two, colours come back 1.6 of 255 too
# dark on average.
_ACCURATE = 0x2 | 0x40000 | 0x2000


def pixel_format(height: int, width: int, codec: VideoCodec) -> str:
    """Return the pixel format: colour at half resolution, or at full resolution if a size is odd.

    Raises:
        InvalidSetup: The codec does not support this image size.
    """
    is_odd = bool(height % 2 or width % 2)
    if codec == "av1" and (is_odd or min(height, width) < _SMALLEST_AV1):
        raise InvalidSetup(
            f"Images of {width} x {height} pixels cannot become AV1 video, which needs even sizes of at least "
            f"{_SMALLEST_AV1}. Choose the codec h264, or resize the dataset."
        )
    return "yuv444p" if is_odd else "yuv420p"


def encode_video(
    path: Path, frames: Iterable[NDArray[Any]], shape: tuple[int, ...], fps: int, codec: VideoCodec
) -> int:
    """Write a video and return the number of its frames.

    Args:
        path: The file, ending in ".mp4".
        frames: RGB images, (H, W, 3) uint8.
        shape: The shape of each.
        fps: Frames per second.
        codec: How it is compressed.

    Raises:
        InvalidSetup: The codec does not support this image size.
        DatasetError: A frame differs too much from its image however it is encoded, or the disk fails.
    """
    height, width = shape[:2]
    format_ = pixel_format(height, width, codec)
    reformatter = VideoReformatter()  # one for all frames, and one thread: each frame's own would start several

    def converted() -> Iterator[av.VideoFrame]:
        for number, image in enumerate(frames):
            rgb = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="rgb24")
            frame = reformatter.reformat(rgb, format=format_, interpolation=Interpolation.AREA, threads=1)
            frame.pts, frame.time_base = number, Fraction(1, fps)
            yield frame

    with av.open(str(path), "w", options=_REPRODUCIBLE) as output:
        stream: Any = output.add_stream(_ENCODERS[codec], rate=fps, options=_OPTIONS[codec])
        _prepare(stream.codec_context, height, width, format_)
        count = 0
        packets: list[Any] = []
        wrong: dict[int, av.VideoFrame] = {}

        def flush() -> None:
            nonlocal count, wrong
            for options in _MENDING[codec]:
                wrong = _mended(packets, wrong, stream.codec_context, codec, options)
            if wrong:
                raise DatasetError(
                    f"{codec} spoils frame {count + min(wrong)} for {path.name}, and {len(wrong) - 1} after it: a "
                    f"block is off by more than {_LARGEST_ERROR**0.5:.0f} of 255. Choose another codec."
                )
            for number, packet in enumerate(packets, count):
                _mux(output, stream, packet, number, number, fps)
            count += len(packets)
            packets.clear()

        for frame, packet, is_right in _encoded(stream.codec_context, codec, converted()):
            if packet.is_keyframe and len(packets) >= _AT_A_TIME:
                flush()
            # The frame after a key frame that is encoded again refers to the old one.
            if not is_right or (not packet.is_keyframe and len(packets) - 1 in wrong):
                wrong[len(packets)] = frame
            packets.append(packet)
        flush()
    check_video(path, count, fps)
    return count


def _encoded(
    encoder: Any, codec: VideoCodec, frames: Iterable[av.VideoFrame]
) -> Iterator[tuple[av.VideoFrame, Any, bool]]:
    """Yield each frame, its packet, and whether it decodes to what it was."""
    decoder: Any = av.CodecContext.create(_DECODERS[codec], "r")
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
                yield source, packets.popleft(), _largest_error(source, shown) <= _LARGEST_ERROR
    if given or packets:
        raise DatasetError(f"{codec} made {len(packets)} packets more than frames, or lost {len(given)} frames.")


def _mended(
    packets: list[Any], wrong: Mapping[int, av.VideoFrame], first: Any, codec: VideoCodec, options: dict[str, str]
) -> dict[int, av.VideoFrame]:
    """Encode frames again as key frames, put them into the list, and return those that are still wrong."""
    if not wrong:
        return {}
    encoder: Any = av.CodecContext.create(_ENCODERS[codec], "w")
    encoder.options = {**_OPTIONS[codec], **options}
    encoder.time_base, encoder.framerate = first.time_base, first.framerate
    encoder.flags |= Flags.global_header
    _prepare(encoder, first.height, first.width, first.pix_fmt)
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


def _prepare(encoder: Any, height: int, width: int, format_: str) -> None:
    encoder.width, encoder.height, encoder.pix_fmt = width, height, format_
    encoder.thread_count = 1
    encoder.colorspace, encoder.color_range = _BT601, _LIMITED
    os.environ.setdefault("SVT_LOG", "1")  # otherwise it prints thirty lines per video
    _open_quietly(encoder)


def _largest_error(one: av.VideoFrame, other: av.VideoFrame) -> float:
    """Return the largest mean squared difference of a block of 16 x 16 values, over all planes."""
    return max(_of_block(_values(a), _values(b)) for a, b in zip(one.planes, other.planes, strict=True))


def _of_block(one: NDArray[Any], other: NDArray[Any]) -> float:
    difference = np.maximum(one, other) - np.minimum(one, other)
    if int(difference.max(initial=0)) ** 2 <= _LARGEST_ERROR:
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


def _mux(output: Any, stream: Any, packet: Any, pts: int, dts: int, fps: int) -> None:
    packet.stream, packet.time_base = stream, Fraction(1, fps)
    packet.pts, packet.dts, packet.duration = pts, dts, 1
    output.mux(packet)


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


def check_video(path: Path, frames: int, fps: int) -> None:
    """Check the number of frames of a video, and their stamps against n / fps.

    Args:
        path: The file.
        frames: The expected number.
        fps: Frames per second.

    Raises:
        DatasetError: A frame is missing, superfluous, or has a wrong stamp.
    """
    with av.open(str(path)) as source:
        stamps = sorted(p.pts * p.time_base for p in source.demux(video=0) if p.pts is not None and p.time_base)
    if stamps != [Fraction(n, fps) for n in range(frames)]:
        raise DatasetError(
            f"The video {path} should have {frames} frames at {fps} Hz and has {len(stamps)}, "
            "or has them at wrong times. Encoding failed; nothing was exported."
        )


class VideoJoiner:
    """Joins videos of `encode_video` without encoding again."""

    def __init__(self, path: Path, fps: int) -> None:
        """Start a file.

        Args:
            path: The file, ending in ".mp4".
            fps: Frames per second of all.
        """
        self.path = path
        self.frames = 0
        self.size = 0
        self._fps = fps
        self._output: Any = av.open(str(path), "w", options=_REPRODUCIBLE)
        self._stream: Any = None
        self._parameters: Any = None

    def takes(self, path: Path) -> bool:
        """Return whether a video can be joined: whether its decoder parameters equal those so far."""
        with av.open(str(path)) as source:
            return self._stream is None or _parameters(source) == self._parameters

    def append(self, path: Path) -> int:
        """Append a video, and return the number of its first frame.

        Args:
            path: The video; `takes` returned True for it.
        """
        first = self.frames
        with av.open(str(path)) as source:
            if self._stream is None:
                self._stream = self._output.add_stream_from_template(source.streams.video[0], opaque=True)
                self._parameters = _parameters(source)
            for packet in source.demux(video=0):
                if packet.pts is None:
                    continue
                self.size += packet.size
                place = first + round(packet.pts * packet.time_base * self._fps)
                _mux(self._output, self._stream, packet, place, self.frames, self._fps)
                self.frames += 1
        return first

    def close(self) -> None:
        """Complete the file and check it; calling it twice is harmless.

        Raises:
            DatasetError: A frame is missing or has a wrong stamp.
        """
        if self._output is not None:
            self._output.close()
            self._output = None
            check_video(self.path, self.frames, self._fps)

    def abort(self) -> None:
        """Close the file without completing it."""
        if self._output is not None:
            self._output.close()
            self._output = None


class VideoReader:
    """Reads frames of one video by time; in order, each is decoded once and none is kept."""

    def __init__(self, path: Path) -> None:
        """Open a video.

        Args:
            path: The file.

        Raises:
            CorruptEpisode: It is missing or not a video.
        """
        self.path = path
        if not path.is_file():  # reading a pipe would never end
            raise CorruptEpisode(f"{path} is missing or not a video.")
        try:
            self._source = av.open(str(path))
            self._stream = self._source.streams.video[0]
        except (FFmpegError, IndexError) as err:
            raise CorruptEpisode(f"{path} is missing or not a video: {err}.") from err
        self._frames = self._source.decode(self._stream)
        self._next: av.VideoFrame | None = None
        self._reformatter = VideoReformatter()
        self._step()

    def frames(self, start: float, count: int, fps: float) -> Iterator[NDArray[np.uint8]]:
        """Yield frames at a constant rate, (H, W, 3) uint8 RGB.

        Args:
            start: The time of the first [s].
            count: Number of frames.
            fps: Frames per second.

        Raises:
            CorruptEpisode: No frame is within half a period of a time.
        """
        if self._next is None or _time(self._next) > start + 0.5 / fps:
            self._seek(start)
        for i in range(count):
            time = start + i / fps
            while self._next is not None and _time(self._next) < time - 0.5 / fps:
                self._step()
            if self._next is None or abs(_time(self._next) - time) > 0.5 / fps:
                raise CorruptEpisode(f"The video {self.path} has no frame at {time:.4f} s.")
            rgb = self._reformatter.reformat(self._next, format="rgb24", interpolation=_ACCURATE, threads=1)
            yield np.asarray(rgb.to_ndarray(), np.uint8)

    def close(self) -> None:
        """Close the file; calling it twice is harmless."""
        self._source.close()

    def _step(self) -> None:
        try:
            self._next = next(self._frames, None)
        except FFmpegError as err:
            raise CorruptEpisode(f"Cannot decode the video {self.path}: {err}.") from err

    def _seek(self, time: float) -> None:
        base = self._stream.time_base or Fraction(1, 1000)
        self._source.seek(max(0, round(time / base)), stream=self._stream, backward=True)
        self._frames = self._source.decode(self._stream)
        self._step()


def decode_image(data: bytes) -> NDArray[np.uint8]:
    """Return the image in the bytes of a PNG, JPEG or similar file, (H, W, 3) uint8 RGB.

    Raises:
        CorruptEpisode: The bytes are not an image.
    """
    try:
        with av.open(io.BytesIO(data), "r") as source:
            frame = next(source.decode(video=0))
            rgb = VideoReformatter().reformat(frame, format="rgb24", interpolation=_ACCURATE, threads=1)
            return np.asarray(rgb.to_ndarray(), np.uint8)
    except (FFmpegError, StopIteration, IndexError) as err:
        raise CorruptEpisode(f"The {len(data)} bytes are not an image: {err!r}.") from err


def encode_depth_video(path: Path, frames: Iterable[NDArray[Any]], shape: tuple[int, ...], fps: int) -> int:
    """Write depth images as a lossless video (FFV1, 16 bits), and return their number.

    Args:
        path: The file, ending in ".mkv".
        frames: Depth images, (H, W) uint16.
        shape: The shape of each.
        fps: Frames per second.
    """
    count = 0
    with av.open(str(path), "w", options=_REPRODUCIBLE) as output:
        stream: Any = output.add_stream("ffv1", rate=fps)
        stream.height, stream.width = shape[:2]
        stream.pix_fmt = "gray16le"
        stream.codec_context.thread_count = 1
        for count, image in enumerate(frames, 1):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray16le")
            frame.pts, frame.time_base = count - 1, Fraction(1, fps)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return count


def decode_depth_video(path: Path) -> Iterator[NDArray[np.uint16]]:
    """Yield the depth images that `encode_depth_video` encoded.

    Raises:
        CorruptEpisode: The file is missing or damaged.
    """
    if not path.is_file():
        raise CorruptEpisode(f"{path} is missing or not a video.")
    try:
        with av.open(str(path)) as source:
            for frame in source.decode(video=0):
                yield np.asarray(frame.to_ndarray(), np.uint16)
    except (FFmpegError, IndexError) as err:  # the second if it has no video stream
        raise CorruptEpisode(f"{path} is missing or cannot be decoded: {err}.") from err


def _parameters(source: Any) -> tuple[Any, ...]:
    context = source.streams.video[0].codec_context
    return context.name, context.width, context.height, bytes(context.extradata or b"")


def _time(frame: av.VideoFrame) -> float:
    return frame.time or 0.0
