"""Writes and reads videos with exact frames at exact times.

Frame n is stamped n / fps, never with the wall clock, since trainers look frames up by time. How frames are encoded
and compared is in `video_codec`.

Measured on 1 354 frames of 224 x 224 pixels of a simulated lab, one core of a busy machine, comparison included: H.264
("superfast", CRF 18) 1050 frames/s, 2.3 kB a frame, worst block 31.9 dB; AV1 (preset 12, CRF 30, as LeRobot's own) 380
frames/s, 1.5 kB, worst block 25.0 dB (20.6 dB, were no frame encoded again). Both halve the resolution of colour
(4:2:0), which is most of the error.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.video_codec import (
    ENCODERS,
    LARGEST_ERROR,
    OPTIONS,
    encoded_in_parts,
    prepare_encoder,
    rgb_image,
    yuv_frames,
)
from rcs_data.video_format import VideoCodec, pixel_format

# Without it, every Matroska file gets a random number.
_REPRODUCIBLE = {"fflags": "+bitexact"}


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
    with av.open(str(path), "w", options=_REPRODUCIBLE) as output:
        stream: Any = output.add_stream(ENCODERS[codec], rate=fps, options=OPTIONS[codec])
        format_ = pixel_format(shape[0], shape[1], codec)
        prepare_encoder(stream.codec_context, shape, format_)
        count = 0
        for packets, wrong in encoded_in_parts(stream.codec_context, codec, yuv_frames(frames, format_, fps)):
            if wrong:
                raise DatasetError(
                    f"{codec} spoils frame {count + min(wrong)} for {path.name}, and {len(wrong) - 1} after it: a "
                    f"block is off by more than {LARGEST_ERROR**0.5:.0f} of 255. Choose another codec."
                )
            for number, packet in enumerate(packets, count):
                _mux(output, stream, packet, number, number, fps)
            count += len(packets)
    check_video(path, count, fps)
    return count


def _mux(output: Any, stream: Any, packet: Any, pts: int, dts: int, fps: int) -> None:
    packet.stream, packet.time_base = stream, Fraction(1, fps)
    packet.pts, packet.dts, packet.duration = pts, dts, 1
    output.mux(packet)


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
            yield rgb_image(self._next, self._reformatter)

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
            return rgb_image(next(source.decode(video=0)), VideoReformatter())
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
