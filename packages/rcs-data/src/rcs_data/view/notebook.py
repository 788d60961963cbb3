"""How datasets and episodes look in a notebook: small tables with pictures, which need nothing else."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.codec import encode_jpeg
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.clips import pictures

_MOST_EPISODES = 12
_HEIGHT = 96


def picture_tag(rgb: NDArray[np.uint8], *, height: int = _HEIGHT, title: str = "") -> str:
    """Return a picture as an `img` tag that has it inside.

    Args:
        rgb: Shape (H, W, 3).
        height: The height on the page [px]; a larger picture is made smaller.
        title: What it is of.
    """
    stride = max(1, rgb.shape[0] // (2 * height))  # twice as fine, for dense displays
    data = encode_jpeg(np.ascontiguousarray(rgb[::stride, ::stride]), 85, "420")
    source = base64.b64encode(data).decode("ascii")
    words = html.escape(title)
    return f'<img src="data:image/jpeg;base64,{source}" height="{height}" alt="{words}" title="{words}">'


def dataset_html(dataset: Dataset) -> str:
    """Return a table of a dataset's first episodes, with the first frame of each camera."""
    name, task = html.escape(dataset.path.resolve().name), html.escape(dataset.info.instruction)
    shown = dataset.episodes[:_MOST_EPISODES]
    rows = "".join(f"<tr>{_cells(record)}</tr>" for record in shown)
    more = len(dataset) - len(shown)
    rest = f"<p>and {more} more; <code>rcs data view</code> shows all.</p>" if more > 0 else ""
    head = "<tr><th>episode</th><th>outcome</th><th>steps</th><th>first frames</th></tr>"
    facts = f"{len(dataset)} episodes at {dataset.info.frequency:g} Hz"
    return f"<p><b>{name}</b>: {task}<br>{facts}</p><table>{head}{rows}</table>{rest}"


def episode_html(record: EpisodeRecord) -> str:
    """Return the facts of an episode, with the first, a middle and the last frame of each camera."""
    try:
        facts = f"{_verdict(record)}, {record.length} steps at {record.info.frequency:g} Hz, seed {record.seed}"
        steps = sorted({0, record.length // 2, record.length - 1})
        lines = [f"<div>{''.join(_tags(record, feature, steps))}</div>" for feature in _cameras(record)]
        text = f"{html.escape(record.instruction)}<br>{facts}"
        return f"<p><b>{html.escape(record.id)}</b>: {text}</p>{''.join(lines)}"
    except CorruptEpisode as err:
        return f"<p><b>{html.escape(record.id)}</b>: {html.escape(str(err))}</p>"


def _cells(record: EpisodeRecord) -> str:
    try:
        tags = "".join(tag for feature in _cameras(record) for tag in _tags(record, feature, [0]))
        cells = [_verdict(record), str(record.length), tags]
    except CorruptEpisode as err:
        cells = ["damaged", "", html.escape(str(err))]
    return "".join(f"<td>{cell}</td>" for cell in [html.escape(record.id), *cells])


def _verdict(record: EpisodeRecord) -> str:
    failure = record.outcome.get("failure") if record.success is False else None
    words = {True: "success", False: "failure", None: "not judged"}[record.success]
    return html.escape(f"{words}: {failure}" if failure else words)


def _cameras(record: EpisodeRecord) -> list[Feature]:
    return [feature for feature in pictures(record.info) if feature.shape[2:] == (3,) and feature.is_image]


def _tags(record: EpisodeRecord, feature: Feature, steps: list[int]) -> Iterator[str]:
    frames: Any = record.frames(feature.key)
    at = 0
    for step in steps:
        image = next(islice(frames, step - at, None))
        at = step + 1
        yield picture_tag(image, title=f"{feature.key}, step {step}")
