"""Records imported steps as rows: of n steps of another format, each an observation and what was done then, n + 1 rows.

The row after the last step needs an observation that most formats lack. It is then repeated from the row before, and
the episode's outcome says so: "repeated" as `imported.last_observation`, and the features as `imported.repeated`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.convert.observations import is_done
from rcs_data.convert.options import ImportOptions
from rcs_data.errors import CorruptEpisode
from rcs_data.files.feature import Feature
from rcs_data.files.flags import FrameFlag, companion
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import new_output
from rcs_data.read.reader import Dataset
from rcs_data.record.rows import Value
from rcs_data.record.writer import DatasetWriter

_PROGRESS_ROWS = 32


@dataclass(frozen=True, kw_only=True)
class StepColumn:
    """The values of a feature in an episode."""

    feature: Feature
    """The feature."""
    values: Iterable[Any]
    """A value per step: of the feature's shape, or an encoded image."""
    last: Any = None
    """The observation after the last step; None to repeat the one before."""


@dataclass(frozen=True, kw_only=True)
class EpisodeAbout:
    """The description of an episode beside its rows."""

    id: str
    """Its id in the dataset."""
    instruction: str = ""
    """Its instruction."""
    seed: int | None = None
    """The seed it was reset with."""
    success: bool | None = None
    """Whether it succeeded."""
    outcome: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """The rest of its outcome."""
    imported: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Its origin, as JSON."""

    @classmethod
    def of_provenance(cls, origin: Mapping[str, Any], imported: Mapping[str, Any]) -> EpisodeAbout:
        """Return what a checked `provenance` stores of an episode."""
        given = {name: origin[name] for name in ("instruction", "seed", "success", "outcome")}
        return cls(id=origin["episode"], **given, imported={**imported, "provenance": dict(origin)})


Record = Callable[[DatasetWriter], Iterator[int]]
"""Records one episode, and yields the number of each written row, from 0."""


def import_episodes(
    out: str | Path, info: DatasetInfo, episodes: Iterable[tuple[int, Record]], options: ImportOptions, steps: int = 0
) -> Dataset:
    """Make a dataset of episodes, whole or not at all; damaged ones are left out, if that is allowed.

    Args:
        out: The folder of the new dataset.
        info: The facts that its episodes share.
        episodes: The number of each, for notes, and what records it.
        options: Says whether episodes may be left out.
        steps: How many there are in all, for the progress; 0 if that is not known.

    Raises:
        CorruptEpisode: An episode is damaged and may not be left out, or none is left.
        DatasetError: `out` exists, or the disk fails.
    """
    done = imported = 0
    with new_output(out) as partial:
        with DatasetWriter.open(partial, info) as writer:
            for index, record in episodes:
                row = 0
                try:
                    for row in record(writer):
                        if options.on_progress is not None and row % _PROGRESS_ROWS == 0:
                            options.on_progress(done + row, steps)
                    imported += 1
                except CorruptEpisode as err:
                    leave_out(f"Episode {index}", err, options)
                done += row
                if options.on_progress is not None:
                    options.on_progress(done, steps)
        if not imported:
            raise CorruptEpisode("No episode can be imported: all are missing or damaged.")
    return Dataset.open(out)


def leave_out(what: str, err: CorruptEpisode, options: ImportOptions) -> None:
    """Note what was left out, or raise the error if that is not allowed."""
    if not options.allow_missing:
        raise err
    if options.on_note is not None:
        options.on_note(f"{what} was left out: {err}")


def record_steps(
    writer: DatasetWriter,
    steps: int,
    columns: Iterable[StepColumn],
    about: EpisodeAbout,
) -> Iterator[int]:
    """Record an episode, and yield the number of each written row.

    Args:
        writer: The dataset.
        steps: Number of steps.
        columns: A column for each feature of the dataset.
        about: Further facts that are known of the episode.

    Raises:
        CorruptEpisode: A column has fewer values than there are steps.
    """
    given = [(column, iter(column.values)) for column in columns]
    features = [column.feature for column, _ in given]
    flagged = {f.key: flags for f in features if f.is_image and (flags := companion(f.key, features, "flags"))}
    row: dict[str, Value] = {}
    with ExitStack() as on_error:
        episode = writer.episode(about.id, seed=about.seed, instruction=about.instruction)
        on_error.callback(episode.discard)
        for i in range(steps + 1):
            row = {column.feature.key: _value(column, values, i, steps, row) for column, values in given}
            for key, flags in flagged.items():
                if i and row[flags] is not None and int(np.asarray(row[flags])) & FrameFlag.REPEATED:
                    row[key] = None
            episode.add(row)
            yield i
        repeated = [c.feature.key for c, _ in given if c.last is None and not is_done(c.feature)]
        ended = {"last_observation": "repeated", "repeated": repeated} if repeated else {"last_observation": "kept"}
        episode.finish(about.success, {**about.outcome, "imported": {**about.imported, **ended}})
        on_error.pop_all()


def _value(column: StepColumn, values: Iterator[Any], row: int, steps: int, before: Mapping[str, Value]) -> Value:
    feature = column.feature
    value: Any
    if row == 0 and is_done(feature):
        return None if feature.is_unknown_at_reset else np.zeros(feature.shape, feature.numpy_dtype)[()]
    if is_done(feature) or row < steps:
        value = next(values, _ENDED)
        if value is _ENDED:
            raise CorruptEpisode(f"There are fewer values of {feature.key!r} than rows.")
    elif column.last is not None:
        value = column.last
    elif feature.is_flags:
        value = np.asarray(before[feature.key]) | FrameFlag.REPEATED
    else:
        return None if feature.is_image or feature.is_time else before[feature.key]
    if isinstance(value, bytes) or value is None:
        return value
    value = np.asarray(value, feature.numpy_dtype).reshape(feature.shape)[()]
    unknown = (row == 0 and feature.is_unknown_at_reset) or (feature.is_time and not np.isfinite(value))
    return None if unknown else value


_ENDED = object()
