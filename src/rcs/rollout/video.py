"""Writes pictures as an H.264 video for browsers and players."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray


class Video:
    """Writes a video file, one picture at a time."""

    def __init__(self, path: str | Path, *, rate: float) -> None:
        """Begin a file.

        Args:
            path: Path of the file, `.mp4`; its folder is created.
            rate: Pictures per second.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._container = av.open(str(path), "w")
        self._stream = self._container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": "23", "preset": "veryfast"}
        self._is_open = True
        self._has_size = False

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Add a picture (H, W, 3), rows from the top; an odd edge loses a pixel."""
        height, width = (edge - edge % 2 for edge in picture.shape[:2])
        if not self._has_size:
            self._stream.width, self._stream.height = width, height
            self._has_size = True
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file. Closing twice is harmless."""
        if self._is_open:
            self._is_open = False
            self._container.mux(self._stream.encode(None))
            self._container.close()
