"""The images of one camera in one episode, by their numbers in `frames.arrow`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.codec import blank_frame, decode_frame, encode_lossless
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.frames_file import FramesFile
from rcs_data.info import DatasetInfo
from rcs_data.video_packets import VideoDecoder, follows


class EpisodeImages:
    """Reads images of one feature in any order; of a video, each takes two packets at most. Not thread-safe."""

    def __init__(
        self,
        feature: Feature,
        info: DatasetInfo,
        file: FramesFile,
        numbers: NDArray[np.int32],
        decoder: VideoDecoder | None = None,
    ) -> None:
        """Read nothing yet.

        Args:
            feature: The feature.
            info: What the dataset's episodes share.
            file: The images of the episode.
            numbers: The number of the feature's image in each row of the episode, -1 before the first.
            decoder: One of this feature to use again, whichever episode it was used for.
        """
        self._feature, self._info = feature, info
        self._file, self._numbers = file, numbers
        self._decoder = decoder or VideoDecoder(feature)

    def shown(self, numbers: NDArray[np.int32]) -> Iterator[bytes]:
        """Yield images as files, black for -1; equal ones in sequence are the same object."""
        last, image = None, b""
        for number in numbers.tolist():
            if number != last:
                last, image = number, self.encoded(number)
            yield image

    def encoded(self, number: int) -> bytes:
        """Return an image as a file: as stored, or of a video as QOI; black for -1.

        Raises:
            CorruptEpisode: It cannot be read.
        """
        if number < 0:
            return blank_frame(self._feature, self._info)
        return self._file.image(number) if self._feature.video is None else encode_lossless(self.decoded(number))

    def decoded(self, number: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return an image, black for -1.

        Args:
            number: Its number.
            out: Where to put it: contiguous, with the feature's shape and dtype; None for a new array.

        Raises:
            CorruptEpisode: It cannot be read; the message has the first row that shows it.
        """
        if number < 0:
            image: NDArray[Any] = np.zeros(self._feature.shape, self._feature.numpy_dtype)
        else:
            row = int(np.searchsorted(self._numbers, number))
            data = self._file.image(number)
            try:
                if self._feature.video is None:
                    return decode_frame(self._feature, data, out)
                image = self._of_video(number, data, row)
            except CorruptEpisode as err:
                raise CorruptEpisode(f"{self._file.path}, {self._feature.key!r}, row {row}: {err}") from err
        if out is None:
            return image
        out[...] = image
        return out

    def _of_video(self, number: int, data: bytes, row: int) -> NDArray[np.uint8]:
        path = self._file.path
        before = int(self._numbers[row - 1]) if row else -1
        if follows(data) and self._decoder.last != (path, before):
            self._decoder.skip(self._file.image(before), (path, before))
        return self._decoder.decode(data, (path, number))
