"""What is exported and imported, and how: options that all formats share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from rcs.data.feature import Feature
from rcs.data.reader import Dataset, EpisodeRecord
from rcs.errors import InvalidSetup

Codec = Literal["h264", "av1"]
OnProgress = Callable[[int, int], None]
"""Called with the steps done and the steps in all; of an import the second may be 0, where it is not known before."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """What of a dataset is exported, and how.

    Raises:
        InvalidSetup: An option does not make sense.
    """

    episodes: tuple[str, ...] | None = None
    """Ids of the episodes, in this order; None for all."""
    success_only: bool = False
    """Whether episodes that did not succeed, or of which nobody said so, are left out."""
    state: tuple[str, ...] | None = None
    """Features that make up the state, in this order; None for joints, then gripper or hand, robot by robot."""
    action: tuple[str, ...] | None = None
    """Features that make up the action, in this order; None for the arm's part, then gripper or hand."""
    extra: tuple[str, ...] = ()
    """More features of numbers, each kept as a column of its own."""
    cameras: tuple[str, ...] | None = None
    """Cameras; None for all. An empty tuple leaves all images out, as does "none" on the command line."""
    robot_type: str | None = None
    """What the format calls the robot; None for the name in the setup."""
    fps: int | None = None
    """The rate to claim [Hz], where a format wants a whole number and the dataset has none; None for the true one."""
    codec: Codec = "h264"
    """How videos are compressed, in formats that have videos."""
    compress: bool = True
    """Whether images are compressed without loss where the format leaves the choice: smaller, and slower to read."""
    name: str | None = None
    """What the export is called, in formats that have a name inside; None for the name of the dataset's folder."""
    workers: int = 1
    """Threads that encode; each is one core."""
    on_progress: OnProgress | None = None
    """Called now and then while the export runs."""

    def __post_init__(self) -> None:
        """Refuse what no format could do."""
        if self.codec not in get_args(Codec):
            raise InvalidSetup(f"The codec is {self.codec!r}; valid are {', '.join(get_args(Codec))}.")
        if self.fps is not None and self.fps < 1:
            raise InvalidSetup(f"fps is {self.fps}; it must be at least 1.")
        if self.workers < 1:
            raise InvalidSetup(f"workers is {self.workers}; it must be at least 1.")


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How a foreign dataset becomes one of ours."""

    jpeg_quality: int = 95
    """1 to 100; images are compressed once more, so lower than the default shows."""
    lossless: bool = False
    """Whether colour images are kept without loss instead."""
    instruction: str | None = None
    """What the robot was asked to do, where the source does not say so."""
    frequency: float | None = None
    """Steps per second [Hz], where the source does not say so."""
    on_progress: OnProgress | None = None
    """Called now and then while the import runs."""


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """What an export wrote."""

    path: Path
    """The file or folder."""
    episodes: int
    """Episodes in it."""
    steps: int
    """Steps in all of them; an episode of T + 1 rows has T."""
    frames: int
    """Images, all cameras together."""
    bytes_written: int
    """Size on disk."""
    notes: tuple[str, ...] = ()
    """What the format could not take, or was changed; one sentence each."""


def stored_as(feature: Feature, options: ImportOptions) -> Feature:
    """Return a feature of an imported dataset with its images stored as the options say."""
    return replace(feature, encoding="lossless") if options.lossless and feature.encoding == "jpeg" else feature


def selected_episodes(dataset: Dataset, options: ExportOptions) -> tuple[EpisodeRecord, ...]:
    """Return the episodes that are to be exported; each has at least one step.

    Args:
        dataset: The dataset.
        options: Which episodes.

    Raises:
        InvalidSetup: An id is unknown or given twice, or nothing is left.
        CorruptEpisode: An episode's description is damaged.
    """
    ids = options.episodes
    if ids is not None and len(set(ids)) < len(ids):
        raise InvalidSetup(f"Episodes are given twice: {', '.join(sorted({i for i in ids if ids.count(i) > 1}))}.")
    known = {episode.id: episode for episode in dataset.episodes}
    unknown = [i for i in ids or () if i not in known]
    if unknown:
        raise InvalidSetup(
            f"There is no episode {', '.join(unknown)} in {dataset.path}, which has {len(known)} episodes."
        )
    chosen = [known[i] for i in ids] if ids is not None else list(known.values())
    kept = [e for e in chosen if e.length > 1 and (e.success is True or not options.success_only)]
    if not kept:
        wanted = "that succeeded and has" if options.success_only else "with"
        raise InvalidSetup(
            f"Of {len(chosen)} chosen episodes of {dataset.path} there is none {wanted} a step to export."
        )
    return tuple(kept)


def selected_cameras(names: dict[str, object] | list[str], options: ExportOptions) -> tuple[str, ...]:
    """Return the names of the cameras that are to be exported.

    Args:
        names: The cameras that there are.
        options: Which of them.

    Raises:
        InvalidSetup: A name is unknown.
    """
    if options.cameras is None:
        return tuple(names)
    unknown = [name for name in options.cameras if name not in names]
    if unknown:
        raise InvalidSetup(f"There is no camera {', '.join(unknown)}. Known: {', '.join(names) or 'none'}.")
    return options.cameras
