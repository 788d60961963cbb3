"""Options of exports and imports that all formats share."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

from rcs_data.errors import InvalidSetup, require_fields
from rcs_data.files.feature import Feature
from rcs_data.files.info import Quality
from rcs_data.files.output import OnProgress
from rcs_data.options import Positive, Record, Whole
from rcs_data.read.reader import Dataset, EpisodeRecord

VideoCodec = Literal["h264", "av1"]


class ExportOptions(Record):
    """How to export a dataset.

    Raises:
        InvalidSetup: An option does not make sense.
    """

    episodes: tuple[str, ...] | None = None
    """Ids of episodes to export, in order; None for all."""
    success_only: bool = False
    """Whether to leave out episodes that failed or have no verdict."""
    state: tuple[str, ...] | None = None
    """Features that make up the state, in order; None for joints, then gripper or hand, robot by robot."""
    action: tuple[str, ...] | None = None
    """Features that make up the action, in order; None for the arm's part, then gripper or hand."""
    extra: tuple[str, ...] = ()
    """More features of numbers to export, each as its own column."""
    cameras: tuple[str, ...] | None = None
    """Cameras to export; None for all, an empty tuple (`none` on the command line) for none."""
    robot_type: str | None = None
    """Name of the robot in the export; None for that in the setup."""
    fps: Whole | None = None
    """Frame rate to claim [Hz], if the format needs a whole number; None for the true one."""
    codec: VideoCodec = "h264"
    """Compression of videos, in formats that have them."""
    compress: bool = True
    """Whether to compress images without loss, if the format leaves the choice: smaller, but slower to read."""
    name: str | None = None
    """Name of the export, in formats that store one; None for that of the dataset's folder."""
    shard_mb: Whole = 200
    """Largest size of a file of several episodes [MB], in RLDS."""
    normalise: bool = False
    """Whether to scale each number of the action to [-1, 1], as robomimic's policies expect; the file has the scale."""
    workers: Whole = 1
    """Threads that encode, one core each."""
    on_progress: OnProgress | None = None
    """Called now and then while the export runs."""


class ImportOptions(Record):
    """How to import a dataset of another format.

    Raises:
        InvalidSetup: An option does not make sense.
    """

    jpeg_quality: Quality = 95
    """1 to 100; images are compressed again, so a value below the default is visible."""
    lossless: bool = False
    """Whether to store colour images without loss instead."""
    instruction: str | None = None
    """The instruction, if the source does not say."""
    frequency: Positive | None = None
    """Control steps per second [Hz], if the source does not say."""
    episodes: tuple[str, ...] | None = None
    """Numbers of episodes to import, and ranges such as 0-99 or 200-; None for all."""
    cameras: tuple[str, ...] | None = None
    """Cameras to import; None for all, an empty tuple (`none` on the command line) for none."""
    allow_missing: bool = False
    """Whether to leave out, and name, episodes whose rows or videos are missing or damaged, instead of refusing all."""
    on_progress: OnProgress | None = None
    """Called now and then while the import runs."""
    on_note: Callable[[str], object] | None = None
    """Called with a sentence for each episode that was left out."""


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """The result of an export."""

    path: Path
    """The file or folder."""
    episodes: int
    """Episodes in it."""
    steps: int
    """Steps in all of them."""
    frames: int
    """Images, all cameras together."""
    bytes_written: int
    """Size on disk."""
    notes: tuple[str, ...] = ()
    """Omissions and changes, one sentence each."""


def stored_as(feature: Feature, options: ImportOptions) -> Feature:
    """Return a feature of an imported dataset, its images encoded according to the options."""
    return replace(feature, encoding="lossless") if options.lossless and feature.colour is not None else feature


def refuse_unused(options: ExportOptions, format_: str, used: Collection[str]) -> None:
    """Refuse options that a format has no use for.

    Args:
        options: The options.
        format_: Name to call the format by.
        used: Those of the format, besides those that all have.

    Raises:
        InvalidSetup: One of the others is given.
    """
    known = {*used, "episodes", "success_only", "cameras", "workers", "on_progress"}
    given = [one.name for one in fields(options) if one.name not in known and getattr(options, one.name) != one.default]
    if given:
        raise InvalidSetup(
            f"{format_} has no use for {', '.join(given)}; leave it out. It takes {', '.join(sorted(known))}."
        )


def export_name(dataset: Dataset, options: ExportOptions) -> str:
    """Return the name of an export: that of the options, else of the dataset's folder in letters, digits and "_".

    Raises:
        InvalidSetup: The name has other characters.
    """
    name = options.name
    if name is None:
        name = re.sub(r"\W+", "_", dataset.path.resolve().name, flags=re.ASCII).strip("_").lower()
        name = name if name[:1].isalpha() else f"rcs_{name}".rstrip("_")
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise InvalidSetup(f"{name!r} cannot name an RLDS dataset; use letters, digits and '_', first a letter.")
    return name


def selected_episodes(dataset: Dataset, options: ExportOptions) -> tuple[EpisodeRecord, ...]:
    """Return the episodes to export; each has at least one step.

    Args:
        dataset: The dataset.
        options: Episodes to export.

    Raises:
        InvalidSetup: An id is unknown or given twice, or nothing is left.
        CorruptEpisode: An episode's description is damaged.
    """
    ids = options.episodes
    if ids is not None and len(set(ids)) < len(ids):
        raise InvalidSetup(f"Episodes are given twice: {', '.join(sorted({i for i in ids if ids.count(i) > 1}))}.")
    if unknown := [i for i in ids or () if i not in dataset]:
        raise InvalidSetup(
            f"There is no episode {', '.join(unknown)} in {dataset.path}, which has {len(dataset)} episodes."
        )
    kept = tuple(episode for episode in _wanted(dataset, options) if episode.length > 1)
    if not kept:
        wanted = "that succeeded and has" if options.success_only else "with"
        why = "".join(f" {note}" for note in no_step_notes(dataset, options))
        number = len(dataset if ids is None else ids)
        raise InvalidSetup(
            f"None of the {number} chosen episodes of {dataset.path} is one {wanted} a step to export.{why}"
        )
    return kept


def _wanted(dataset: Dataset, options: ExportOptions) -> list[EpisodeRecord]:
    """Return the chosen episodes, with and without steps."""
    chosen = dataset.episodes if options.episodes is None else [dataset[i] for i in options.episodes]
    return [episode for episode in chosen if episode.success is True or not options.success_only]


def no_step_notes(dataset: Dataset, options: ExportOptions) -> Iterator[str]:
    """Yield a note if chosen episodes have no step, and so are left out."""
    if short := [episode.id for episode in _wanted(dataset, options) if episode.length < 2]:
        yield f"Left out, because they have one row and so no step: {', '.join(short[:5])}{' …' * (len(short) > 5)}."


def selected_numbers(ranges: Sequence[str] | None, known: Iterable[int]) -> list[int]:
    """Return the numbers of episodes in their order, given numbers and ranges such as "0-99" or "200-"; None for all.

    Raises:
        InvalidSetup: A text is neither, or names no known episode.
    """
    kept = sorted(known)
    if ranges is None:
        return kept
    chosen: set[int] = set()
    for text in ranges:
        start, dash, stop = text.partition("-")
        is_range = start.isdecimal() and (stop.isdecimal() or not stop)
        named = {n for n in kept if int(start) <= n <= (int(stop or n) if dash else int(start))} if is_range else set()
        if not named:
            raise InvalidSetup(
                f"{text!r} names no episode; valid are numbers and ranges such as 0-99 or 200-, "
                f"of {len(kept)} episodes from {min(kept, default=0)} to {max(kept, default=0)}."
            )
        chosen |= named
    return sorted(chosen)


def selected_cameras(names: Iterable[str], options: ExportOptions | ImportOptions) -> tuple[str, ...]:
    """Return the names of the chosen cameras.

    Args:
        names: All cameras.
        options: Those to export or import.

    Raises:
        InvalidSetup: A name is unknown.
    """
    names = list(names)
    if options.cameras is None:
        return tuple(names)
    require_fields("camera of this dataset", options.cameras, names)
    return options.cameras
