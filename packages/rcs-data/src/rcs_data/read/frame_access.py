"""Single images of episodes in any order, without reading those around them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import InvalidSetup
from rcs_data.files.codec import pixel_buffer
from rcs_data.files.frames_file import FramesFile
from rcs_data.files.layout import FRAMES_FILE
from rcs_data.read.episode_record import EpisodeRecord, decoded

# Memory for the numbers of images [B], 4 per row and camera: 64 million images. Beyond it, those of the least recently
# used episode are read again when needed.
_INDEX_BYTES = 1 << 28
# All readers of a process together; it may open 1024 files by default.
_MOST_OPEN = 256
T = TypeVar("T")


class ByteCache(Generic[T]):
    """Values by key, of limited size in bytes; the least recently used go first. Not thread-safe."""

    def __init__(self, capacity: int) -> None:
        """Start empty.

        Args:
            capacity: Bytes that all values together may take; the newest stays even if it alone takes more.

        Raises:
            InvalidSetup: The capacity is negative.
        """
        if capacity < 0:
            raise InvalidSetup(f"A cache cannot hold {capacity} bytes; it must be 0 or more.")
        self.capacity = capacity
        self.nbytes = 0
        self._values: OrderedDict[Hashable, tuple[T, int]] = OrderedDict()

    def __len__(self) -> int:
        """Return how many values are held."""
        return len(self._values)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy nothing but the capacity: another process fills its own."""
        return ByteCache, (self.capacity,)

    def get(self, key: Hashable, make: Callable[[], tuple[T, int]]) -> T:
        """Return a value; make it if it is not in the cache.

        Args:
            key: Its key.
            make: Returns the value and its size [B].
        """
        held = self._values.get(key)
        if held is not None:
            self._values.move_to_end(key)
            return held[0]
        value, size = make()
        self._values[key] = (value, size)
        self.nbytes += size
        while self.nbytes > self.capacity and len(self._values) > 1:
            _, (_, freed) = self._values.popitem(last=False)
            self.nbytes -= freed
        return value


class FrameAccess:
    """Reads single images of episodes. Not thread-safe; a copy in another process opens its own files.

    All of a process together keep at most 256 files open.
    """

    def __init__(self) -> None:
        """Start with nothing read."""
        self._numbers: ByteCache[dict[str, NDArray[np.int32]]] = ByteCache(_INDEX_BYTES)
        self._reader = object()
        self._decoded: dict[tuple[Any, ...], NDArray[Any]] = {}
        finalize(self, _opened.cache_clear).atexit = False  # closes its files, and those of others, which reopen theirs

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy nothing."""
        return FrameAccess, ()

    def frame(self, episode: EpisodeRecord, key: str, row: int) -> NDArray[Any]:
        """Return one image: (H, W, 3) uint8, or (H, W) uint16 millimetres for depth.

        Args:
            episode: The episode.
            key: The feature.
            row: The row.

        Raises:
            InvalidSetup: There is no such feature or row, or the feature is not an image.
            CorruptEpisode: A file is missing or damaged.
        """
        feature = episode.info.feature(key)
        out = np.empty((1, *feature.shape), feature.numpy_dtype)
        self.frames(episode, key, [row], out)
        return out[0]

    def frames(self, episode: EpisodeRecord, key: str, rows: Sequence[int], out: NDArray[Any]) -> None:
        """Decode images into an array; they equal what `EpisodeRecord.frames` yields, bit for bit.

        Args:
            episode: The episode.
            key: The feature.
            rows: The rows, in any order.
            out: Where they go, shape (len(rows), *feature.shape).

        Raises:
            InvalidSetup: There is no such feature or row, or the feature is not an image.
            CorruptEpisode: A file is missing or damaged; the message has the row.
        """
        feature = episode.info.feature(key)
        # Decoding writes line by line, which is slow outside of the processor's cache; this array is in it.
        form = (feature.shape, feature.dtype, feature.encoding)
        image = self._decoded.get(form)
        if image is None:
            is_jpeg = feature.encoding == "jpeg"
            image = pixel_buffer(feature.shape) if is_jpeg else np.empty(feature.shape, feature.numpy_dtype)
            self._decoded[form] = image
        numbers = self._numbers_of(episode, key)
        if wrong := [row for row in rows if not 0 <= row < len(numbers)]:
            raise InvalidSetup(f"Episode {episode.id!r} has no row {wrong[0]}; valid are 0 to {len(numbers) - 1}.")
        file = _opened(self._reader, episode)
        last: int | None = None
        for n, number in enumerate(numbers[np.asarray(rows, np.intp)].tolist()):
            if number != last:
                decoded(feature, file, number, rows[n], image)
            out[n] = image
            last = number

    def _numbers_of(self, episode: EpisodeRecord, key: str) -> NDArray[np.int32]:
        def read() -> tuple[dict[str, NDArray[np.int32]], int]:
            # All cameras are read at once, since one window has all of them.
            numbers = episode.image_numbers(feature.key for feature in episode.info.features if feature.is_image)
            return numbers, sum(column.nbytes for column in numbers.values())

        if not episode.info.feature(key).is_image:
            raise InvalidSetup(f"{key!r} is not an image; read it with column({key!r}).")
        return self._numbers.get(episode.place, read)[key]


@lru_cache(_MOST_OPEN)
def _opened(_reader: object, episode: EpisodeRecord) -> FramesFile:
    """Return the open file with an episode's images; another reader opens it anew, since it may have been replaced."""
    return FramesFile(episode.path / FRAMES_FILE)
