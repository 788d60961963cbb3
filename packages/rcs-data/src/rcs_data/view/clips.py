"""Clips of an episode: one small video per camera with a frame per row, in which a browser finds any frame at once."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import av
import numpy as np
import simplejpeg
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.files.codec import ONE_THREAD
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.options import Meta, Record, Whole
from rcs_data.read.reader import EpisodeRecord

Codec = Literal["h264", "vp9"]

_ENCODERS: dict[str, tuple[str, dict[str, str]]] = {
    "h264": ("libx264", {"preset": "veryfast", "bf": "0", "tune": "fastdecode"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "cpu-used": "8", "b": "0", "lag-in-frames": "0"}),
}
# Maps from pixels to numbers, such as the indentation of a gel, have at least this many rows and columns; camera
# matrices have fewer.
_SMALLEST_MAP = 8
_SAMPLES = 12
# The colours of depth follow what the camera sees: they span the frames this long before and after [s].
_WINDOW = 0.25
# From dark blue over teal and green to a light yellow: lightness rises all the way.
_ANCHORS = np.array(
    [(18, 20, 66), (26, 70, 128), (20, 121, 138), (40, 164, 112), (142, 202, 74), (250, 240, 130)], np.float64
)
_PLACES = np.linspace(0, 255, len(_ANCHORS))
_TABLE = np.stack([np.interp(np.arange(256), _PLACES, channel) for channel in _ANCHORS.T], axis=1).astype(np.uint8)
# A pixel without a value is darker than any value.
_NOTHING = np.zeros(3, np.uint8)
_Limits = NDArray[np.float64]


class ClipOptions(Record):
    """How clips are made.

    Raises:
        InvalidSetup: A field does not make sense.
    """

    height: Annotated[int, Meta(ge=16)] = 320
    """The largest height [px]; smaller images stay as they are."""
    codec: Codec = "h264"
    """"h264" plays nearly everywhere; "vp9" in browsers that were built without it, and takes longer to make."""

    quality: int = 26
    """The codec's constant rate factor: lower is better and larger."""
    whole_frame_every: Whole = 10
    """A browser that seeks decodes so many frames at most. With 10, clips of 224 x 224 are 1.6 times as large as with
    the encoder's own choice of 250, and a third of those in which every frame is whole."""


def pictures(info: DatasetInfo) -> list[Feature]:
    """Return the features that a clip can show: images, and maps from pixels to numbers that stand beside them."""
    return [feature for feature in info.features if feature.is_image or _is_map(feature)]


def write_clip(episode: EpisodeRecord, feature: Feature, path: Path, options: ClipOptions) -> list[list[float]] | None:
    """Write the images of one of `pictures` as an MP4 file with a frame for each row, row i shown from i / fps on.

    Returns:
        The values that the darkest and the lightest colour stand for, for each frame, or once where they stay; None
        for a picture in its own colours.

    Raises:
        CorruptEpisode: The images do not read.
        DatasetError: The file cannot be written.
    """
    is_colour = feature.shape[-1:] == (3,) and len(feature.shape) == 3
    limits = None if is_colour or feature.encoding == "labels" else _limits(episode, feature)
    encoder, fixed = _ENCODERS[options.codec]
    settings = {**fixed, "crf": str(options.quality), "g": str(options.whole_frame_every)}
    rate = Fraction(episode.info.frequency).limit_denominator(1000)
    rows, columns = _size(feature, options.height)
    address = str(path.absolute())  # FFmpeg takes a relative "12:30/…" for one of the network
    with av.open(address, "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream(encoder, rate=rate, options=settings)
        stream.width, stream.height, stream.pix_fmt = columns, rows, "yuv420p"
        stream.thread_count = 1  # several clips are made at the same time
        reformatter: Any = VideoReformatter()
        for row, image in enumerate(_images(episode, feature, limits, rows)):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame = reformatter.reformat(
                frame, columns, rows, "yuv420p", interpolation="AREA", dst_colorspace="ITU601", **ONE_THREAD
            )
            frame.pts, frame.time_base = row, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return None if limits is None else [[float(f"{v:.4g}") for v in pair] for pair in limits]


def _is_map(feature: Feature) -> bool:
    return "/frames/" in feature.key and len(feature.shape) == 2 and min(feature.shape) >= _SMALLEST_MAP


def _size(feature: Feature, height: int) -> tuple[int, int]:
    rows, columns = feature.shape[:2]
    scale = min(1.0, height / rows)
    # Colour has half the resolution in these codecs, so both lengths must be even.
    return max(2, 2 * round(scale * rows / 2)), max(2, 2 * round(scale * columns / 2))


def _images(episode: EpisodeRecord, feature: Feature, limits: _Limits | None, rows: int) -> Iterator[NDArray[np.uint8]]:
    """Yield what a clip shows, in colour; for JPEG near the clip's size already, which is faster to decode."""
    if limits is not None:
        for row, values in enumerate(_values(episode, feature)):
            low, high = limits[min(row, len(limits) - 1)]
            yield coloured(values, (low, high))
        return
    if feature.encoding == "labels":
        yield from (_label_colours()[labels] for labels in episode.frames(feature.key))
        return
    if feature.encoding != "jpeg":
        yield from episode.frames(feature.key)
        return
    last, image = None, np.empty(0, np.uint8)
    for row, data in enumerate(episode.encoded_frames(feature.key)):
        if data is not last:
            try:
                image = simplejpeg.decode_jpeg(data, "RGB", fastdct=True, fastupsample=True, min_height=rows)
            except ValueError as err:
                raise CorruptEpisode(f"{feature.key}, row {row}: the JPEG does not decode: {err}.") from err
            last = data
        yield image


@cache
def _label_colours() -> NDArray[np.uint8]:
    """Return a colour for each number, black for 0: hues a golden section apart, so that neighbours differ."""
    turns = np.arange(1 << 16) * (np.sqrt(5.0) - 1.0) / 2.0
    hue = np.abs((turns[:, None] + np.array([0.0, 2.0, 1.0]) / 3.0) % 1.0 * 6.0 - 3.0) - 1.0
    brightness = np.array([1.0, 0.72, 0.5])[np.arange(1 << 16) % 3, None]
    colours = (255 * brightness * (0.25 + 0.75 * np.clip(hue, 0.0, 1.0))).astype(np.uint8)
    colours[0] = 0
    return colours


def _values(episode: EpisodeRecord, feature: Feature) -> Iterator[NDArray[Any]]:
    return episode.frames(feature.key) if feature.is_image else iter(episode.column(feature.key))


def _limits(episode: EpisodeRecord, feature: Feature) -> _Limits:
    """Return the values that the colours span, nearly all there are: shape (frames, 2) for depth, else (1, 2).

    A camera in the hand sees half a metre and then a few centimetres: colours for both would show neither.
    """
    if feature.encoding == "depth":
        fine = (values[::3, ::3] for values in episode.frames(feature.key))
        spans = np.array([_span(values[values > 0]) for values in fine], np.float64)  # 0 is no reading
        reach = max(1, round(_WINDOW * episode.info.frequency))
        return _apart(_smooth(spans.reshape(-1, 2), reach))
    shown = np.unique(np.linspace(0, episode.length - 1, _SAMPLES).astype(int))
    samples = episode.column(feature.key)[shown].astype(np.float64)
    return _apart(np.nan_to_num(np.array([_span(samples[np.isfinite(samples)])])))


def _span(values: NDArray[Any]) -> tuple[float, float]:
    if not values.size:
        return np.nan, np.nan
    low, high = np.percentile(values, (1, 99))
    return float(low), float(high)


def _apart(spans: _Limits) -> _Limits:
    """Return spans whose ends differ, also in the four digits that are shown."""
    least = np.maximum(2e-3 * np.abs(spans[:, 0]), 1e-6)
    return np.stack([spans[:, 0], np.maximum(spans[:, 1], spans[:, 0] + least)], 1)


def _smooth(spans: _Limits, reach: int) -> _Limits:
    """Return for each frame the mean of the spans around it, so that colours do not flicker."""
    kernel = np.ones(2 * reach + 1)
    known = np.isfinite(spans).astype(np.float64)
    sums = [np.convolve(column, kernel)[reach : reach + len(column)] for column in np.nan_to_num(spans).T]
    counts = [np.convolve(column, kernel)[reach : reach + len(column)] for column in known.T]
    return np.stack(sums, 1) / np.maximum(np.stack(counts, 1), 1)


def coloured(values: NDArray[Any], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """Return the colours of numbers (H, W), shape (H, W, 3); black where there is none: NaN and, in integers, 0.

    The limits are the values of the darkest and the lightest colour.
    """
    low, high = limits
    is_known = np.isfinite(values) if values.dtype.kind == "f" else values != 0
    places = (np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0) - low) * (255 / (high - low))
    colours = _TABLE[np.clip(places, 0, 255).astype(np.uint8)]
    return np.where(is_known[..., None], colours, _NOTHING)
