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
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.bitstream import BitStreamFilterContext
from av.error import FFmpegError
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.feature import Feature
from rcs_data.video_codec import (
    DECODERS,
    ENCODERS,
    LARGEST_ERROR,
    OPTIONS,
    encoded_in_parts,
    prepare_encoder,
    rgb_image,
    yuv_frames,
)
from rcs_data.video_format import VideoCodec, pixel_format
from rcs_data.video_packets import bare_packet, is_packet, kept_packets

# Without it, every Matroska file gets a random number.
_REPRODUCIBLE = {"fflags": "+bitexact"}
# Packets that may wait for their frames; H.264 reorders at most 16.
_MOST_REORDERED = 32
_AV1_DELIMITER = b"\x12\x00"
"""The OBU before each frame in a stream, which containers leave out."""
_RAW: dict[VideoCodec, str] = {"h264": "h264", "av1": "obu"}
"""FFmpeg's names of streams without a container."""


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


def copy_video(
    path: Path,
    packets: Iterable[bytes],
    images: Iterable[NDArray[np.uint8]],
    shape: tuple[int, ...],
    fps: int,
    codec: VideoCodec,
) -> bool:
    """Write the packets of a dataset as a video, without encoding again; return False where that cannot be.

    It can be where no image is a file or missing, and readers of such exports know the pixel format. Every frame is
    read again and compared.

    Args:
        path: The file, ending in ".mp4".
        packets: Images of a video as a dataset stores them; `b""` for one that repeats the one before it.
        images: The same images.
        shape: The shape of each.
        fps: Frames per second.
        codec: What they are compressed with.

    Raises:
        CorruptEpisode: The dataset is damaged.
        DatasetError: The disk fails.
    """
    try:
        return _copied(path, packets, shape, fps, codec) and _has_images(path, images, fps)
    except FFmpegError:  # a damaged packet: whoever decodes it tells where
        return False


def _copied(path: Path, packets: Iterable[bytes], shape: tuple[int, ...], fps: int, codec: VideoCodec) -> bool:
    given = iter(packets)
    first = next(given, b"")
    if not is_packet(first) or not bare_packet(first)[1]:
        return False
    with (
        av.open(io.BytesIO(bare_packet(first)[0]), format=_RAW[codec]) as raw,
        av.open(str(path), "w", options=_REPRODUCIBLE) as output,
    ):
        if raw.streams.video[0].codec_context.pix_fmt != pixel_format(shape[0], shape[1], codec):
            return False
        stream = output.add_stream_from_template(raw.streams.video[0], opaque=True)
        for number, stored in enumerate(chain([first], given)):
            if not is_packet(stored):
                return False
            data, is_key = bare_packet(stored)
            packet = av.Packet(data)
            packet.is_keyframe = is_key
            _mux(output, stream, packet, number, number, fps)
    return True


def _has_images(path: Path, images: Iterable[NDArray[np.uint8]], fps: int) -> bool:
    reader = VideoReader(path)
    try:
        count = 0
        for count, image in enumerate(images, 1):
            if not np.array_equal(next(reader.frames((count - 1) / fps, 1, fps)), image):
                return False
    finally:
        reader.close()
    check_video(path, count, fps)
    return True


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
        self._frames = self._decoded()
        self._next: tuple[av.VideoFrame, Any] | None = None
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
        for frame, _ in self._at_times(start, count, fps):
            yield rgb_image(frame, self._reformatter)

    def images(self, start: float, count: int, fps: float, feature: Feature) -> Iterator[NDArray[np.uint8] | bytes]:
        """Yield the same frames as a dataset stores them: the packets of this video where that can be, else arrays.

        It can be where the codec is the same, every second frame at least is a key frame, and each packet gives the
        same pixels by itself, or after the key frame before it.

        Args:
            start: The time of the first [s].
            count: Number of frames.
            fps: Frames per second.
            feature: What they become.

        Raises:
            CorruptEpisode: No frame is within half a period of a time.
        """
        codec = self._stream.codec_context.name
        try:
            same = feature.video is not None and codec in DECODERS[feature.video]
            is_kept = same and self._has_keys(start, count, fps)
        except FFmpegError:  # whoever decodes it tells where
            is_kept = False
        if not is_kept:
            yield from self.frames(start, count, fps)
            return
        given = self._at_times(start, count, fps)
        yield from kept_packets(
            feature, ((rgb_image(frame, self._reformatter), *self._bare(packet)) for frame, packet in given)
        )

    def _at_times(self, start: float, count: int, fps: float) -> Iterator[tuple[av.VideoFrame, Any]]:
        """Yield frames at a constant rate, and the packets that they came in."""
        if self._next is None or _time(self._next[0]) > start + 0.5 / fps:
            self._seek(start)
        for i in range(count):
            time = start + i / fps
            while self._next is not None and _time(self._next[0]) < time - 0.5 / fps:
                self._step()
            if self._next is None or abs(_time(self._next[0]) - time) > 0.5 / fps:
                raise CorruptEpisode(f"The video {self.path} has no frame at {time:.4f} s.")
            yield self._next

    def _decoded(self) -> Iterator[tuple[av.VideoFrame, Any]]:
        waiting: dict[int | None, Any] = {}
        for packet in self._source.demux(self._stream):
            if len(waiting) > _MOST_REORDERED:
                waiting.clear()
            if packet.pts is not None:
                waiting[packet.pts] = packet
            for frame in packet.decode():
                yield frame, waiting.pop(frame.pts, None)

    def _has_keys(self, start: float, count: int, fps: float) -> bool:
        """Return whether the first and every second of some frames at least are key frames; decodes nothing."""
        first, end = start - 0.5 / fps, start + (count - 0.5) / fps
        keys: dict[float, bool] = {}
        with av.open(str(self.path)) as source:
            stream: Any = source.streams.video[0]
            source.seek(max(0, round(start / (stream.time_base or Fraction(1, 1000)))), stream=stream, backward=True)
            for packet in source.demux(stream):
                time = 0.0 if packet.pts is None else float(packet.pts * packet.time_base)
                if packet.pts is None or (packet.dts is not None and packet.dts * packet.time_base > end):
                    break
                if first <= time <= end:
                    keys[time] = packet.is_keyframe
        in_order = [keys[time] for time in sorted(keys)]
        return len(in_order) == count and in_order[0] and all(one or other for one, other in pairwise(in_order))

    def _bare(self, packet: Any) -> tuple[bytes, bool]:
        """Return a packet as it stands in a stream without a container, and whether it is a key frame."""
        if packet is None:
            return b"", False
        data = bytes(packet)
        if self._stream.codec_context.name in DECODERS["av1"]:
            return data if data.startswith(_AV1_DELIMITER) else _AV1_DELIMITER + data, packet.is_keyframe
        try:
            changed = BitStreamFilterContext("h264_mp4toannexb", self._stream).filter(av.Packet(data))
        except FFmpegError:
            return b"", False
        return b"".join(map(bytes, changed)), packet.is_keyframe

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
        try:
            self._source.seek(max(0, round(time / base)), stream=self._stream, backward=True)
        except FFmpegError as err:
            raise CorruptEpisode(f"Cannot find {time:.4f} s in the video {self.path}: {err}.") from err
        self._frames = self._decoded()
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
