"""A small video of an episode, all cameras side by side."""

from __future__ import annotations

import io
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.data import EpisodeRecord
from rcs.data.codec import decode_small_jpeg

HEIGHT = 224
"""Largest height of a clip [px]."""
_FPS = 15.0


def colour_cameras(episode: EpisodeRecord) -> list[str]:
    """Return the keys of the cameras in a clip."""
    return [feature.key for feature in episode.info.features if feature.encoding == "jpeg"]


def encode_clip(episode: EpisodeRecord) -> bytes | None:
    """Return an MP4 (H.264) of at most 15 frames per second; None if there is no camera.

    Args:
        episode: The episode; the clip plays at its recorded rate.

    Raises:
        CorruptEpisode: The frames cannot be read.
    """
    import av  # takes 50 ms to import, and only reports need it

    keys = colour_cameras(episode)
    if not keys:
        return None
    stride = max(1, round(episode.info.frequency / _FPS))
    shapes = [episode.info.feature(key).shape for key in keys]
    columns = [list(episode.encoded_frames(key))[::stride] for key in keys]
    rate = Fraction(max(1, round(1000 * episode.info.frequency / stride)), 1000)
    target = io.BytesIO()
    with av.open(target, "w", format="mp4") as container:
        stream: Any = None
        for jpegs in zip(*columns, strict=True):
            image = _side_by_side([_small(jpeg, shape) for jpeg, shape in zip(jpegs, shapes, strict=True)])
            if stream is None:
                options = {"preset": "veryfast", "crf": "30", "tune": "fastdecode"}
                stream = container.add_stream("libx264", rate=rate, options=options)
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.thread_count = 1  # several clips are made in parallel
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return target.getvalue() or None


def _small(jpeg: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    # The decoder can shrink images by eighths, which is faster and finer than dropping pixels later.
    eighths = [-(-shape[0] * k // 8) for k in range(1, 9)]
    wanted = max([h for h in eighths if h <= HEIGHT], default=eighths[0])
    image = decode_small_jpeg(jpeg, shape, wanted)
    stride = -(-image.shape[0] // HEIGHT)
    return image[::stride, ::stride]


def _side_by_side(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    height = max(image.shape[0] for image in images)
    width = sum(image.shape[1] for image in images)
    # Colour has half the resolution in H.264, so both lengths must be even.
    canvas = np.zeros((height + height % 2, width + width % 2, 3), np.uint8)
    x = 0
    for image in images:
        canvas[: image.shape[0], x : x + image.shape[1]] = image
        x += image.shape[1]
    return canvas
