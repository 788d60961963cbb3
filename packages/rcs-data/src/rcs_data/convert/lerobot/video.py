"""Writes and reads videos with exact frames at exact times.

Frame n is stamped n / fps, never with the wall clock, since trainers look frames up by time. Key frames are two apart
in H.264, and no frame refers to a later one, so that a reader reaches any frame by decoding two, and videos can be
joined without encoding again. In AV1 every frame is a key frame: SVT-AV1 leaves blocks of an earlier frame in others.

Measured on 684 frames of 96 x 96 pixels of a simulated lab, worst block of 16 x 16 pixels: H.264 ("superfast", CRF 18)
0.85 kB a frame, 24.3 dB; AV1 (preset 12, CRF 35) 0.87 kB, 24.9 dB; AV1 with LeRobot's own CRF 30 and key frames two
apart 0.65 kB, 21.0 dB, 12 % of the frames below 25 dB. Both halve the resolution of colour (4:2:0), which is most of
the error.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from av.video.reformatter import Interpolation, VideoReformatter
from numpy.typing import NDArray

from rcs_data.convert.options import VideoCodec
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.codec import ONE_THREAD

# Without it, every Matroska file gets a random number.
_REPRODUCIBLE = {"fflags": "+bitexact"}
# FFmpeg's names of the encoders, and their options: one thread each, since episodes are encoded in parallel, and the
# result must not depend on the number of cores.
_ENCODERS: dict[VideoCodec, tuple[str, dict[str, str]]] = {
    "h264": ("libx264", {"preset": "superfast", "crf": "18", "g": "2", "bf": "0"}),
    "av1": ("libsvtav1", {"preset": "12", "crf": "35", "g": "1", "svtav1-params": "lp=1"}),
}
# Limits of libx264 and SVT-AV1: least length, most lines and most columns [px].
_LIMITS: dict[VideoCodec, tuple[int, int, int]] = {"h264": (1, 16384, 16384), "av1": (64, 8704, 16384)}
# ITU-R BT.601 in limited range, FFmpeg's default for RGB and so what readers expect.
_BT601, _LIMITED = 5, 1
# FFmpeg's SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT: without the last two, colours come back 1.6 of 255 too
# dark on average.
_ACCURATE = 0x2 | 0x40000 | 0x2000


def pixel_format(height: int, width: int, codec: VideoCodec) -> str:
    """Return the pixel format of an export: colour at half resolution, or at full resolution if a size is odd.

    Raises:
        InvalidSetup: The codec does not support this image size.
    """
    is_odd = bool(height % 2 or width % 2)
    least, most_lines, most_columns = _LIMITS[codec]
    is_in_range = least <= min(height, width) and height <= most_lines and width <= most_columns
    if not is_in_range or (codec == "av1" and is_odd):
        needs = f"{'even ' if codec == 'av1' else ''}sizes from {least} to {most_columns} x {most_lines}"
        raise InvalidSetup(
            f"Images of {width} x {height} pixels cannot become {codec.upper()} video, which needs {needs}. "
            f"Choose {'the codec h264, or ' if codec == 'av1' else ''}another size."
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
        DatasetError: The encoder fails, or the disk.
    """
    name, options = _ENCODERS[codec]
    reformatter = VideoReformatter()  # one for all frames, and one thread: each frame's own would start several
    count = 0
    try:
        with av.open(str(path), "w", options=_REPRODUCIBLE) as output:
            stream: Any = output.add_stream(name, rate=fps, options=options)
            encoder = stream.codec_context
            encoder.height, encoder.width, encoder.pix_fmt = *shape[:2], pixel_format(shape[0], shape[1], codec)
            encoder.thread_count, encoder.colorspace, encoder.color_range = 1, _BT601, _LIMITED
            _open_quietly(encoder)
            for count, image in enumerate(frames, 1):
                rgb = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="rgb24")
                frame = reformatter.reformat(
                    rgb, format=encoder.pix_fmt, interpolation=Interpolation.AREA, **ONE_THREAD
                )
                frame.pts, frame.time_base = count - 1, Fraction(1, fps)
                output.mux(stream.encode(frame))
            output.mux(stream.encode(None))
    except FFmpegError as err:
        raise DatasetError(f"Cannot encode {shape[1]} x {shape[0]} pixels as {codec}: {err}.") from err
    check_video(path, count, fps)
    return count


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
    """Joins videos of `encode_video` without encoding again, in files of limited size."""

    def __init__(self, path_of: Callable[[int], Path], fps: int, limit: int) -> None:
        """Start without a file.

        Args:
            path_of: Returns the path of a file, ending in ".mp4", given its number from 0.
            fps: Frames per second of all.
            limit: Size beyond which a new file begins [B].
        """
        self._path_of, self._fps, self._limit = path_of, fps, limit
        self._files = self._frames = self._size = 0
        self._output: Any = None
        self._stream: Any = None

    def append(self, path: Path) -> tuple[int, int]:
        """Append a video, and return the number of its file and of its first frame there.

        Args:
            path: The video, of the same codec, options and shape as those before.

        Raises:
            DatasetError: In the file that is complete now, a frame is missing or has a wrong stamp.
        """
        if self._output is not None and self._size + path.stat().st_size > self._limit:
            self.close()
        with av.open(str(path)) as source:
            if self._output is None:
                self._output = av.open(str(self._path_of(self._files)), "w", options=_REPRODUCIBLE)
                self._stream = self._output.add_stream_from_template(source.streams.video[0], opaque=True)
                self._files, self._frames, self._size = self._files + 1, 0, 0
            first = self._frames
            for packet in source.demux(video=0):
                if packet.pts is None:
                    continue
                place = first + round(packet.pts * packet.time_base * self._fps)
                packet.stream, packet.time_base = self._stream, Fraction(1, self._fps)
                packet.pts, packet.dts, packet.duration = place, self._frames, 1
                self._output.mux(packet)
                self._size += packet.size
                self._frames += 1
        return self._files - 1, first

    def close(self, *, is_whole: bool = True) -> None:
        """Close the open file and check it, or close it without that; calling it twice is harmless.

        Raises:
            DatasetError: A frame is missing or has a wrong stamp.
        """
        output, self._output = self._output, None
        if output is not None:
            output.close()
            if is_whole:
                check_video(self._path_of(self._files - 1), self._frames, self._fps)


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
            self._source = av.open(str(path.absolute()))  # FFmpeg takes a relative "12:30/…" for an address
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
            rgb = self._reformatter.reformat(self._next, format="rgb24", interpolation=_ACCURATE, **ONE_THREAD)
            yield np.asarray(rgb.to_ndarray(), np.uint8)

    def close(self) -> None:
        """Close the file; calling it twice is harmless."""
        self._source.close()

    def _step(self) -> None:
        self._next = None  # after an error the decoder yields no more, so the next frame is sought
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
        self._frames = self._source.decode(self._stream)
        self._step()


def _open_quietly(encoder: Any) -> None:
    """Open an encoder, and take back the real-time priority that SVT-AV1 gives this thread and its own, if it may."""
    os.environ.setdefault("SVT_LOG", "1")  # otherwise it prints thirty lines per video
    if not hasattr(os, "sched_getscheduler"):
        encoder.open()
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    before = set(os.listdir("/proc/self/task")) - {str(threading.get_native_id())}
    encoder.open()
    for thread in set(os.listdir("/proc/self/task")) - before:
        with suppress(ProcessLookupError):  # it has ended
            os.sched_setscheduler(int(thread), policy, parameter)


def _time(frame: av.VideoFrame) -> float:
    return frame.time or 0.0
