"""The images of a video feature as packets: what `frames.arrow` has of them in a complete episode.

An image is a byte that says whether it is a key frame (1) or follows one (0), the CRC-32 of its packet, and the packet.
It is decoded alone, or after the image before it of the same camera, which is a key frame. All that follows the first
five bytes, packet after packet, is a stream that FFmpeg plays. What no encoding comes near to stays the file it was.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pyarrow as pa
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.codec import decode_frame
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.video_codec import decode_packet, encode_clip, open_decoder, rgb_image

_KEY, _NEXT = b"\x01", b"\x00"
_HEAD = 5
# Rows are held until their images are encoded. Each such part begins with key frames, so that its bytes do not depend
# on how the rows came.
_ROWS_IN_A_CLIP = 32


def packed(info: DatasetInfo, pieces: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the rows of an episode with its videos as packets; what are packets already stays as it is.

    Args:
        info: The features.
        pieces: All rows, with images, in pieces of any size.

    Raises:
        DatasetError: An encoder fails.
    """
    videos = [feature for feature in info.features if feature.video is not None]
    for rows in _clips(pieces) if videos else pieces:
        whole = rows
        for feature in videos:
            place = whole.schema.get_field_index(feature.key)
            images = whole.column(place).to_pylist()
            if not any(image is not None and is_packet(image) for image in images):
                column = pa.array(_packets(feature, images), pa.binary())
                whole = whole.set_column(place, whole.schema.field(place), column)
        yield whole


def stored_packet(packet: bytes, is_key: bool) -> bytes:
    """Return a packet as it is stored."""
    return (_KEY if is_key else _NEXT) + zlib.crc32(packet).to_bytes(_HEAD - 1, "little") + packet


def is_packet(data: bytes) -> bool:
    """Return whether a stored image is a packet; otherwise, it is a file."""
    return data[:1] in (_KEY, _NEXT)


def is_whole_packet(data: bytes) -> bool:
    """Return whether bytes are what `stored_packet` returned."""
    return is_packet(data) and zlib.crc32(data[_HEAD:]) == int.from_bytes(data[1:_HEAD], "little")


def bare_packet(data: bytes) -> tuple[bytes, bool]:
    """Return the packet that is stored, and whether it is a key frame."""
    return data[_HEAD:], data[:1] == _KEY


def kept_packets(
    feature: Feature, frames: Iterable[tuple[NDArray[np.uint8], bytes, bool]]
) -> Iterator[bytes | NDArray[np.uint8]]:
    """Yield images of another video as its packets, where they can be stored; otherwise as they are.

    Args:
        feature: One of a video with the same codec.
        frames: Of each image the pixels, the packet that they came from, and whether that is a key frame.
    """
    decoder = VideoDecoder(feature)
    for image, packet, is_key in frames:
        stored = stored_packet(packet, is_key)
        with suppress(CorruptEpisode):
            if np.array_equal(decoder.decode(stored), image):
                yield stored
                continue
        decoder.last = None
        yield image


def follows(data: bytes) -> bool:
    """Return whether a stored image is a packet that is decoded after the one before it."""
    return data[:1] == _NEXT


def _packets(feature: Feature, images: list[bytes | None]) -> list[bytes | None]:
    assert feature.video is not None, "of a video"
    frames = (decode_frame(feature, image) for image in images if image is not None)
    try:
        packets = iter(encode_clip(frames, feature.shape, feature.video))
    except CorruptEpisode:
        return images  # and a check names the damaged one
    made = list(images)
    for place, image in enumerate(images):
        if image is not None and (packet := next(packets)) is not None:
            made[place] = stored_packet(*packet)
    return made


def _clips(pieces: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the same rows in pieces of the size of a clip; the last may be smaller."""
    waiting: list[pa.Table] = []
    held = 0
    for piece in pieces:
        start = 0
        while held + piece.num_rows - start >= _ROWS_IN_A_CLIP:
            part = piece.slice(start, _ROWS_IN_A_CLIP - held)
            yield pa.concat_tables([*waiting, part])
            waiting, held, start = [], 0, start + part.num_rows
        if start < piece.num_rows:
            waiting.append(piece.slice(start))
            held += piece.num_rows - start
    if waiting:
        yield pa.concat_tables(waiting)


class VideoDecoder:
    """Decodes stored images of a video feature. Not thread-safe."""

    def __init__(self, feature: Feature) -> None:
        """Open nothing yet.

        Args:
            feature: One of a video.
        """
        self.last: object = None
        """What the last image was called if it is a key frame, so that the one after it can be decoded."""
        self._feature = feature
        self._codec: Any = None
        self._reformatter = VideoReformatter()

    def decode(self, data: bytes, name: object = True) -> NDArray[np.uint8]:
        """Return the image in the bytes of `frames.arrow`, (H, W, 3).

        Args:
            data: The bytes; of one that `follows`, those of the image before it were given before.
            name: What to call it.

        Raises:
            CorruptEpisode: They are not what was written, or do not decode.
        """
        if is_packet(data):
            return rgb_image(self._frame(data, name), self._reformatter)
        self.last = None
        return decode_frame(self._feature, data)

    def skip(self, data: bytes, name: object = True) -> None:
        """Take an image only because the next one is decoded after it; otherwise as `decode`."""
        self._frame(data, name)

    def _frame(self, data: bytes, name: object) -> VideoFrame:
        before, self.last = self.last, None
        codec, packet = self._feature.video, data[_HEAD:]
        assert codec is not None, "of a video"
        if not is_whole_packet(data):
            raise CorruptEpisode(f"The {len(data)} bytes are not a packet of {codec} as it was written.")
        if follows(data) and before is None:
            raise CorruptEpisode("The key frame before it is missing or damaged.")
        decoder = self._codec or open_decoder(self._feature.shape, codec)
        self._codec = None  # after an error, another one
        frame = decode_packet(decoder, packet, self._feature.shape, codec)
        self._codec, self.last = decoder, None if follows(data) else name
        return frame
