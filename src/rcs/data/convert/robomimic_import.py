"""Import of HDF5 files for robomimic: our own, which give back every column, and those of others, such as LIBERO's.

A step of robomimic is a row of ours, and an episode has a row more: what was seen after the last step, from `next_obs`.
What has no value there, as all that was seen where a file has no `next_obs`, is repeated from the row before, and the
episode's outcome says so: `imported.last_observation` is "repeated", and `imported.repeated` has the features.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.data.convert.hdf5 import load_h5py
from rcs.data.convert.options import ImportOptions
from rcs.data.output import new_output
from rcs.data.convert.robomimic import LAST_STATE, RCS
from rcs.data.convert.robomimic_source import Column, DemoAbout, SourcePlan, demo_about, demo_names, source_plan
from rcs.data.durable import disk_errors
from rcs.data.reader import Dataset
from rcs.data.rows import Value
from rcs.data.writer import DatasetWriter
from rcs.errors import CorruptEpisode, InvalidSetup

_PROGRESS_ROWS = 32


def import_robomimic(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Make a dataset of an HDF5 file for robomimic; it is there whole or not at all.

    Args:
        source: The file.
        out: The folder of the new dataset.
        options: How images are stored, and what the file may not say.

    Raises:
        MissingDependency: h5py is not installed.
        InvalidSetup: It is no such file, its episodes differ in form, or its rate is unknown and not in the options.
        CorruptEpisode: An episode has no steps, or its columns are not of one length.
        DatasetError: The file cannot be read, something is at `out`, or the disk fails.
    """
    h5py = load_h5py()
    options = options or ImportOptions()
    with disk_errors("read", Path(source)), h5py.File(source, "r") as file:
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
    """Record an episode, and yield the number of each row that was written."""
    columns = [(column.feature, _rows(demo, column, steps)) for column in plan.columns]
    states = None
    if plan.states is not None:
        states = np.concatenate([demo[plan.states][()], demo[f"{RCS}/{LAST_STATE}"][()][None]])
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


def _rows(demo: Any, column: Column, steps: int) -> Iterator[NDArray[Any]]:
    """Yield the value of each row of an episode, images one by one from the file."""
    feature = column.feature

    def value(given: Any) -> NDArray[Any]:
        return np.asarray(given, feature.numpy_dtype).reshape(feature.shape)[()]

    given = _array(demo, column.path, column, steps)
    after = None if column.after is None else _array(demo, column.after, column, steps)
    rows = given if feature.is_image else given[()]
    if column.is_done and not column.is_whole:
        yield value(np.zeros(feature.shape))
    for i in range(len(given)):
        yield value(rows[i])
    if not (column.is_whole or column.is_done):
        yield value(rows[-1] if after is None else after[-1])


def _array(demo: Any, path: str, column: Column, steps: int) -> Any:
    if path not in demo:
        raise InvalidSetup(f"{demo.name} has no {path!r}, which other episodes have.")
    values = demo[path]
    expected = steps + 1 if column.is_whole else steps
    if len(values) != expected:
        raise CorruptEpisode(f"{values.name} has {len(values)} rows; expected are {expected}.")
    if values.size != expected * column.feature.size:
        raise InvalidSetup(f"{values.name} has shape {values.shape[1:]}; other episodes have {column.feature.shape}.")
    return values


def _steps(demo: Any) -> int:
    if "actions" not in demo or len(demo["actions"]) < 1:
        raise CorruptEpisode(f"{demo.name} has no actions.")
    return int(demo.attrs.get("num_samples", len(demo["actions"])))
