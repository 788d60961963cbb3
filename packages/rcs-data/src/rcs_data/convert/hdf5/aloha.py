"""Imports HDF5 files of ALOHA and ACT: one per episode, `episode_0.hdf5`, or a folder of them.

`/observations/qpos` becomes `observation/joints`, `qvel` `observation/velocity`, `effort` `observation/effort`, and
`images/<camera>` `observation/frames/<camera>/rgb` (`images_depth/<camera>` `.../depth`); `/action` becomes
`action/joints` and `/base_action` `action/base`. So windows and exports find state and action in ALOHA's own order:
six joints [rad] and a gripper (0 closed, 1 open) of the left arm, then of the right. JPEGs, which are padded with
zeros, stay as they are.

An episode has a row more than steps, as `steps` says.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.convert.hdf5 import arrays as hdf5
from rcs_data.convert.images import as_stored, decode_image
from rcs_data.convert.observations import camera_feature, kept_info
from rcs_data.convert.options import ImportOptions, selected_numbers
from rcs_data.convert.steps import EpisodeAbout, StepColumn, import_episodes, record_steps
from rcs_data.errors import CorruptEpisode, InvalidSetup, RcsError
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.read.reader import Dataset
from rcs_data.record.writer import DatasetWriter

_FREQUENCY = 50.0  # DT = 0.02 in the constants.py of ACT and of Mobile ALOHA
_NUMBERS = {
    "observations/qpos": "observation/joints",
    "observations/qvel": "observation/velocity",
    "observations/effort": "observation/effort",
    "action": "action/joints",
    "base_action": "action/base",
}
_IMAGES = ("observations/images", "observations/images_depth")


def is_aloha(path: Path) -> bool:
    """Return whether a file, or the first of a folder, has the arrays of ALOHA; no without h5py."""
    files = _files(path)
    if not files or not hdf5.is_hdf5(files[0]):
        return False
    try:
        with hdf5.reading_hdf5(files[0]) as file:
            return "observations/qpos" in file and "action" in file
    except RcsError:
        return False


def import_aloha(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import ALOHA's HDF5 files, whole or not at all.

    Args:
        source: A file, or the folder with them.
        out: The folder of the new dataset.
        options: Says what to import, how to store images, and what the files do not say; the rate is 50 Hz unless
            `frequency` is given.

    Raises:
        MissingDependency: h5py is not installed.
        InvalidSetup: There are no such files, or they differ in form.
        CorruptEpisode: A file cannot be read, or its columns differ in length.
        DatasetError: `out` exists, or the disk fails.
    """
    options = options or ImportOptions()
    files = _files(Path(source))
    if not files:
        raise InvalidSetup(f"{source} has no files of ALOHA, such as episode_0.hdf5.")
    chosen = selected_numbers(options.episodes, files)
    info, paths = _plan_of_first([files[i] for i in chosen], options)
    return import_episodes(out, info, ((i, partial(_record, files[i], i, info, paths)) for i in chosen), options)


def _plan_of_first(files: list[Path], options: ImportOptions) -> tuple[DatasetInfo, dict[str, str]]:
    """Return the plan of the first file, or with `allow_missing` of the first one that can be read."""
    for number, path in enumerate(files, 1):
        try:
            with hdf5.reading_hdf5(path) as file:
                return _plan(file, options)
        except CorruptEpisode:
            if not options.allow_missing or number == len(files):
                raise
    raise AssertionError("there is a file")


def _record(path: Path, index: int, info: DatasetInfo, paths: dict[str, str], writer: DatasetWriter) -> Iterator[int]:
    with hdf5.reading_hdf5(path) as file:
        steps = len(hdf5.array(file, "action"))
        if not steps:
            raise CorruptEpisode(f"{path} has 0 rows of 'action'; an episode has at least 1.")
        columns = [_column(file, paths[feature.key], feature, steps) for feature in info.features]
        imported: dict[str, Any] = {"file": path.name, "sim": bool(np.all(file.attrs.get("sim", False)))}
        about = EpisodeAbout(id=f"{index:06d}", instruction=info.instruction, imported=imported)
        yield from record_steps(writer, steps, columns, about)


def _files(path: Path) -> dict[int, Path]:
    """Return the file as number 0, or those of a folder by their numbers."""
    if path.is_file():
        return {0: path}
    stems = hdf5.by_number(file.stem for file in path.glob("episode_*.hdf5") if file.is_file())
    return {number: path / f"{stem}.hdf5" for number, stem in stems.items()}


def _plan(file: Any, options: ImportOptions) -> tuple[DatasetInfo, dict[str, str]]:
    """Return the info of the dataset, and the array of each feature by key."""
    if "observations/qpos" not in file or "action" not in file:
        raise InvalidSetup(f"{file.filename} is not a file of ALOHA: it lacks /observations/qpos or /action.")
    found = {path: hdf5.number_feature(key, hdf5.array(file, path)) for path, key in _NUMBERS.items() if path in file}
    left_out: dict[str, str] = {}
    for group in _IMAGES:
        for camera, values in getattr(file.get(group), "items", dict)():
            feature = _camera(camera, values, options)
            if feature is None:
                left_out[f"{group}/{camera}"] = "it has no colour images of 8 bits or depth of 16"
            else:
                found[f"{group}/{camera}"] = feature
    info = DatasetInfo(
        frequency=options.frequency or _FREQUENCY,
        features=tuple(found.values()),
        setup={"imported": {"format": "ALOHA", "left_out": left_out}},
        instruction=options.instruction or "",
        jpeg_quality=options.jpeg_quality,
    )
    return kept_info(info, options), {feature.key: path for path, feature in found.items()}


def _camera(camera: str, values: Any, options: ImportOptions) -> Feature | None:
    if not hdf5.is_numeric(values):
        return None
    if values.ndim != 2 or values.dtype != np.uint8:
        return camera_feature(camera, values.shape[1:], values.dtype.name, options)
    if not len(values):
        raise CorruptEpisode(f"{values.name} in {values.file.filename} has 0 rows; an episode has at least 1.")
    return camera_feature(camera, decode_image(values[0].tobytes()).shape, "uint8", options)  # a padded JPEG per row


def _column(file: Any, path: str, feature: Feature, steps: int) -> StepColumn:
    if feature.colour is not None and getattr(file.get(path), "ndim", None) == 2:
        rows = hdf5.array(file, path)
        if len(rows) != steps:
            raise CorruptEpisode(f"{rows.name} in {file.filename} has {len(rows)} rows; expected {steps}.")
        values = (as_stored(feature, row.tobytes(), path) for row in rows)
        return StepColumn(feature=feature, values=values)
    values = hdf5.checked_array(file, path, feature, steps)
    return StepColumn(feature=feature, values=hdf5.rows_of(values, feature))
