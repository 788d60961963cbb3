"""Imports HDF5 files for robomimic: our own, which restore every column, and others, such as LIBERO's.

A step of robomimic becomes a row, and an episode gets one more: the observation after the last step, from `next_obs`.
Values that are missing there, such as all observations of a file without `next_obs`, are repeated from the row before;
then the episode's outcome has "repeated" as `imported.last_observation` and the features as `imported.repeated`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.hdf5 import reading_hdf5
from rcs_data.convert.options import ImportOptions
from rcs_data.convert.robomimic import LAST_STATE, RCS
from rcs_data.convert.robomimic_source import (
    Column,
    DemoAbout,
    SourcePlan,
    demo_about,
    demo_names,
    is_numeric,
    source_plan,
)
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.output import new_output
from rcs_data.parquet import bound_of
from rcs_data.reader import Dataset
from rcs_data.rows import Value
from rcs_data.writer import DatasetWriter

_PROGRESS_ROWS = 32


def import_robomimic(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import an HDF5 file for robomimic, whole or not at all.

    Args:
        source: The file.
        out: The folder of the new dataset.
        options: How to store images, and what the file does not say.

    Raises:
        MissingDependency: h5py is not installed.
        InvalidSetup: It is not such a file, its episodes differ in form, or its rate is neither in it nor in the
            options.
        CorruptEpisode: The file cannot be read, an episode has no steps, or its columns differ in length.
        DatasetError: `out` exists, or the disk fails.
    """
    options = options or ImportOptions()
    with reading_hdf5(Path(source)) as file:
        demos = demo_names(file)
        plan = source_plan(file, options)
        lengths = [_steps(file["data"][name]) for name in demos]
        done = 0
        with new_output(out) as partial, DatasetWriter.open(partial, plan.info) as writer:
            for index, (name, steps) in enumerate(zip(demos, lengths, strict=True)):
                about = demo_about(file, name, index, plan)
                for row in _record(writer, file["data"][name], steps, plan, about):
                    if options.on_progress is not None and (row % _PROGRESS_ROWS == 0 or row == steps):
                        options.on_progress(done + row, sum(lengths))
                done += steps
    return Dataset.open(out)


def _record(writer: DatasetWriter, demo: Any, steps: int, plan: SourcePlan, about: DemoAbout) -> Iterator[int]:
    """Record an episode, and yield the number of each written row."""
    columns = [(column.feature, _rows(demo, column, steps)) for column in plan.columns]
    states = None
    if plan.states is not None:
        states = _states(demo, plan, steps)
    with writer.episode(about.id, seed=about.seed, instruction=about.instruction) as episode:
        for i in range(steps + 1):
            row: dict[str, Value] = {}
            for feature, rows in columns:
                value = next(rows)
                is_unknown = (i == 0 and feature.is_unknown_at_reset) or (feature.is_time and bool(np.isnan(value)))
                row[feature.key] = None if is_unknown else value
            episode.add(row, None if states is None else states[i])
            yield i
        repeated = [column.feature.key for column in plan.columns if column.is_repeated]
        imported: dict[str, Any] = {
            "episode": demo.name.split("/")[-1],
            "last_observation": "repeated" if repeated else "kept",
            **({"repeated": repeated} if repeated else {}),
            **({"provenance": about.provenance} if about.provenance else {}),
        }
        episode.finish(about.success, {**about.outcome, "imported": imported})


def _states(demo: Any, plan: SourcePlan, steps: int) -> NDArray[np.float64]:
    """Return the simulation's states, shape (steps + 1, size)."""
    size = plan.info.sim_state_size or 0
    given, last = (_dataset(demo, path) for path in (plan.states or "", f"{RCS}/{LAST_STATE}"))
    if given.shape != (steps, size) or last.shape != (size,):
        raise CorruptEpisode(f"{demo.name} has states of {given.shape} and {last.shape}; expected {(steps, size)}.")
    return np.concatenate([np.asarray(given[()], np.float64), np.asarray(last[()], np.float64)[None]])


def _dataset(demo: Any, path: str) -> Any:
    """Return an array of numbers within the size limit of its file."""
    values: Any = demo.get(path)
    if not is_numeric(values):
        raise CorruptEpisode(f"{demo.name} has no array of numbers {path!r}.")
    if values.ndim < 3 and values.size * values.dtype.itemsize > bound_of(values.file.id.get_filesize()):
        raise CorruptEpisode(f"{values.name} claims {values.shape}, which is more than its file can hold.")
    return values


def _rows(demo: Any, column: Column, steps: int) -> Iterator[NDArray[Any]]:
    """Yield the value of each row of an episode, reading images one by one."""
    feature = column.feature

    def value(given: Any) -> NDArray[Any]:
        return np.asarray(given, feature.numpy_dtype).reshape(feature.shape)[()]

    given = _array(demo, column.path, column, steps)
    after = None if column.after is None else _array(demo, column.after, column, steps)
    rows = given if given.ndim > 2 else given[()]  # images one by one
    if column.is_done and not column.is_whole:
        yield value(np.zeros(feature.shape))
    for i in range(len(given)):
        yield value(rows[i])
    if not (column.is_whole or column.is_done):
        yield value(rows[-1] if after is None else after[-1])


def _array(demo: Any, path: str, column: Column, steps: int) -> Any:
    if path not in demo:
        raise InvalidSetup(f"{demo.name} lacks {path!r}, which other episodes have.")
    values = _dataset(demo, path)
    expected = steps + 1 if column.is_whole else steps
    if len(values) != expected:
        raise CorruptEpisode(f"{values.name} has {len(values)} rows; expected {expected}.")
    if values.size != expected * column.feature.size:
        raise InvalidSetup(f"{values.name} has shape {values.shape[1:]}; other episodes have {column.feature.shape}.")
    return values


def _steps(demo: Any) -> int:
    if not hasattr(demo, "keys") or "actions" not in demo:
        raise CorruptEpisode(f"{demo.name} has no actions.")
    count = len(_dataset(demo, "actions"))
    told = demo.attrs.get("num_samples", count)
    if count < 1:
        raise CorruptEpisode(f"{demo.name} has no actions.")
    if np.ndim(told) or told != count:
        raise CorruptEpisode(f"{demo.name} has {count} actions, but num_samples is {told!r:.80}.")
    return count
