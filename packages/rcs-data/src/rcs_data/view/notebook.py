"""How datasets and episodes look in a notebook: small tables with pictures, which need nothing else."""

from __future__ import annotations

from collections.abc import Iterator

from rcs_data.errors import CorruptEpisode
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.clips import pictures
from rcs_data.view.html import Html, element, joined, picture_tag, table

_MOST_EPISODES = 12


def dataset_html(dataset: Dataset) -> str:
    """Return a table of a dataset's first episodes, with the first frame of each camera."""
    shown = dataset.episodes[:_MOST_EPISODES]
    rows = table([_cells(record) for record in shown], ("episode", "outcome", "steps", "first frames"))
    more = len(dataset) - len(shown)
    rest = element("p", f"and {more} more; ", element("code", "rcs-data view"), " shows all.") if more > 0 else None
    facts = f"{len(dataset)} episodes at {dataset.info.frequency:g} Hz"
    name = element("b", dataset.path.resolve().name)
    return joined([element("p", name, f": {dataset.info.instruction}", element("br"), facts), rows, rest])


def episode_html(record: EpisodeRecord) -> str:
    """Return the facts of an episode, with the first, a middle and the last frame of each camera."""
    name = element("b", record.id)
    try:
        facts = f"{_verdict(record)}, {record.length} steps at {record.info.frequency:g} Hz, seed {record.seed}"
        lines = [element("div", *tags) for tags in _frames(record, {0, record.length // 2, record.length - 1})]
        return joined([element("p", name, f": {record.instruction}", element("br"), facts), *lines])
    except CorruptEpisode as err:
        return element("p", name, f": {err}")


def _cells(record: EpisodeRecord) -> list[object]:
    try:
        frames = joined(tag for tags in _frames(record, {0}) for tag in tags)
        return [record.id, _verdict(record), record.length, frames]
    except CorruptEpisode as err:
        return [record.id, "damaged", "", str(err)]


def _verdict(record: EpisodeRecord) -> str:
    failure = record.outcome.get("failure") if record.success is False else None
    words = {True: "success", False: "failure", None: "not judged"}[record.success]
    return f"{words}: {failure}" if failure else words


def _frames(record: EpisodeRecord, steps: set[int]) -> Iterator[list[Html]]:
    """Yield some frames of each colour camera."""
    for feature in pictures(record.info):
        if not (feature.is_image and feature.shape[2:] == (3,)):
            continue
        tags: list[Html] = []
        for step, image in enumerate(record.frames(feature.key)):
            if step in steps:
                tags.append(picture_tag(image, title=f"{feature.key}, step {step}"))
            if step >= max(steps):
                break
        yield tags
