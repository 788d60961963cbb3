"""Imports HDF5 files for robomimic, such as our own and LIBERO's.

`obs/<name>` becomes `observation/<name>`, images `observation/frames/<camera>/rgb` or, of uint16,
`.../depth`; `actions` become `action/action`, `action_dict/<name>` keeps its name, `rewards` become `reward`, `dones`
`terminated`, `states` `simulation/states`; other data per step become `imported/<name>`. An episode's success is known
only if the file has a mask "success" or "failure"; other masks are kept in its outcome, as `imported.masks`.

An episode has a row more than steps, as `steps` says; the last observation is taken from `next_obs` where there is one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.convert.hdf5 import arrays as hdf5
from rcs_data.convert.hdf5.robomimic import NORMALISATION, PROVENANCE, VERDICTS
from rcs_data.convert.observations import ACTION_DICT, camera_feature, is_done, kept_info
from rcs_data.convert.options import ImportOptions, selected_numbers
from rcs_data.convert.provenance import checked_provenance
from rcs_data.convert.steps import EpisodeAbout, StepColumn, import_episodes, record_steps
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.info import MEANING_OF_ACTIONS, DatasetInfo
from rcs_data.files.json_file import parsed_json
from rcs_data.files.text import mended_text
from rcs_data.read.reader import Dataset
from rcs_data.record.writer import DatasetWriter

# Names that are imported by rules of their own; groups are looked into.
_KNOWN = ("obs", "next_obs", "rewards", "dones", "states", ACTION_DICT.strip("/"))


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """How to import a file."""

    info: DatasetInfo
    paths: dict[str, str]
    """The array of each feature, by key."""
    masks: dict[str, list[str]]
    """The masks of each episode, by its name in the file."""


def import_robomimic(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import an HDF5 file for robomimic, whole or not at all.

    Args:
        source: The file.
        out: The folder of the new dataset.
        options: Says what to import, how to store images, and what the file does not say.

    Raises:
        MissingDependency: h5py is not installed.
        InvalidSetup: It is not such a file, its episodes differ in form, or its rate is neither in it nor in the
            options.
        CorruptEpisode: The file cannot be read, an episode has no steps, or its columns differ in length.
        DatasetError: `out` exists, or the disk fails.
    """
    options = options or ImportOptions()
    with hdf5.reading_hdf5(Path(source)) as file:
        names = _demo_names(file)
        plan = _plan(file, [*names.values()], options)
        chosen = selected_numbers(options.episodes, names)
        episodes = ((i, partial(_record, file, names[i], i, plan)) for i in chosen)
        steps = 0 if options.allow_missing else sum(_steps(file["data"][names[i]]) for i in chosen)
        return import_episodes(out, plan.info, episodes, options, steps)


def _record(file: Any, name: str, index: int, plan: _Plan, writer: DatasetWriter) -> Iterator[int]:
    demo = file["data"][name]
    steps = _steps(demo)
    columns = [_column(demo, feature, plan, steps) for feature in plan.info.features]
    return record_steps(writer, steps, columns, _about(file, name, index, plan))


def _demo_names(file: Any) -> dict[int, str]:
    names = hdf5.by_number(file["data"]) if "data" in file and hasattr(file["data"], "keys") else {}
    if not names:
        raise InvalidSetup(f"{file.filename} is not a file for robomimic: it has no episodes in a group 'data'.")
    return names


def _plan(file: Any, names: list[str], options: ImportOptions) -> _Plan:
    data, demo = file["data"], file["data"][names[0]]
    if not hasattr(demo, "keys"):
        raise InvalidSetup(f"{file.filename} is not a file for robomimic: {demo.name} is an array, not an episode.")
    environment = _json_attribute(data, "env_args")
    found: Any = environment.get("env_kwargs")
    kwargs: dict[str, Any] = found if isinstance(found, dict) else {}
    frequency = kwargs.get("control_freq") or options.frequency
    if not isinstance(frequency, int | float) or not frequency:
        raise InvalidSetup(f"{file.filename} does not state its control rate; give frequency.")
    arrays: dict[str, Any] = {}
    for folder in ("obs", ACTION_DICT.strip("/")):
        group = demo.get(folder)
        arrays |= {f"{folder}/{name}": values for name, values in getattr(group, "items", dict)()}
    arrays |= {name: values for name, values in demo.items() if name not in _KNOWN}
    left_out = {path: "it is not an array of numbers" for path, values in arrays.items() if not hdf5.is_numeric(values)}
    features = {path: _feature(path, values, options) for path, values in arrays.items() if path not in left_out}
    if "rewards" in demo:
        features["rewards"] = Feature(key="reward", shape=(), dtype="float64")
    if "dones" in demo:
        features["dones"] = Feature(key="terminated", shape=(), dtype="bool")
    if "states" in demo and hdf5.is_numeric(demo["states"]) and demo["states"].size:
        features["states"] = hdf5.number_feature("simulation/states", demo["states"])
    words = (
        _instruction(data, demo) or options.instruction or kwargs.get("instruction") or environment.get("env_name", "")
    )
    # Our own exports say what the numbers of an action are.
    meaning = {key: kwargs[key] for key in MEANING_OF_ACTIONS if key in kwargs and PROVENANCE in demo.attrs}
    info = DatasetInfo(
        frequency=float(frequency),
        features=tuple(features.values()),
        setup={**meaning, "imported": {"format": "robomimic", "env_args": environment, "left_out": left_out}},
        instruction=mended_text(str(words)),
        jpeg_quality=options.jpeg_quality,
    )
    paths = {feature.key: path for path, feature in features.items()}
    return _Plan(info=kept_info(info, options), paths=paths, masks=_masks(file, names))


def _feature(path: str, values: Any, options: ImportOptions) -> Feature:
    """Return the feature that an array becomes."""
    folder, _, name = path.rpartition("/")
    if folder == "obs":
        camera = re.sub("_(image|rgb|depth)$", "", name)
        image = camera_feature(camera, values.shape[1:], values.dtype.name, options)
        return image or hdf5.number_feature(f"observation/{name}", values)
    if folder:
        return hdf5.number_feature(f"{ACTION_DICT}{name}", values)
    if name.startswith("action"):
        return hdf5.number_feature(f"action/{'action' if name == 'actions' else name}", values)
    return hdf5.number_feature(f"imported/{name}", values)


def _column(demo: Any, feature: Feature, plan: _Plan, steps: int) -> StepColumn:
    path = plan.paths[feature.key]
    values = hdf5.checked_array(demo, path, feature, steps)
    after = f"next_{path}"
    last = None
    if path.startswith("obs/") and after in demo and not is_done(feature):
        last = np.asarray(hdf5.checked_array(demo, after, feature, steps)[-1], feature.numpy_dtype)
    rows = hdf5.rows_of(values, feature)
    if path == "actions" and (stated := _json_attribute(demo.parent, NORMALISATION).get("actions")):
        offset, scale = _normalisation(stated, feature.size)
        rows = (np.asarray(row * scale + offset, feature.numpy_dtype) for row in rows)
    return StepColumn(feature=feature, values=rows, last=last)


def _normalisation(stated: Any, size: int) -> tuple[Any, Any]:
    """Return offset and scale that actions were normalised by, (size,) each.

    Raises:
        CorruptEpisode: The file states something else.
    """
    try:
        offset, scale = (np.ravel(np.asarray(stated[name], np.float64)) for name in ("offset", "scale"))
    except (KeyError, TypeError, ValueError):
        offset = scale = np.empty(0)
    if not offset.size == scale.size == size or not np.isfinite(offset + scale).all():
        raise CorruptEpisode(f"{NORMALISATION} has no offset and scale of {size} finite numbers for the actions.")
    return offset, scale


def _steps(demo: Any) -> int:
    if not hasattr(demo, "keys") or "actions" not in demo or not len(hdf5.array(demo, "actions")):
        raise CorruptEpisode(f"{demo.name} has no actions.")
    count = len(demo["actions"])
    claimed = demo.attrs.get("num_samples", count)
    if np.ndim(claimed) or claimed != count:
        raise CorruptEpisode(f"{demo.name} has {count} actions, but num_samples is {claimed!r:.80}.")
    return count


def _about(file: Any, name: str, index: int, plan: _Plan) -> EpisodeAbout:
    demo = file["data"][name]
    masks = plan.masks[name]
    kept = [mask for mask in masks if mask not in VERDICTS]
    imported: dict[str, Any] = {"episode": name, **({"masks": kept} if kept else {})}
    if PROVENANCE in demo.attrs:
        return EpisodeAbout.of_provenance(checked_provenance(_json_attribute(demo, PROVENANCE), demo.name), imported)
    return EpisodeAbout(
        id=f"{index:06d}",
        instruction=_instruction(file["data"], demo) or plan.info.instruction,
        success=next((VERDICTS[mask] for mask in masks if mask in VERDICTS), None),
        imported=imported,
    )


def _masks(file: Any, names: list[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {name: [] for name in names}
    group = file.get("mask")
    for mask, members in getattr(group, "items", dict)():
        if getattr(members, "ndim", None) == 1 and members.dtype.kind in "SO":
            for member in members[()]:
                name = member.decode(errors="replace") if isinstance(member, bytes) else str(member)
                if name in found:
                    found[name].append(mask)
    return found


def _instruction(data: Any, demo: Any) -> str | None:
    """Return the instruction, from where RoboCasa or LIBERO store it."""
    words = _json_attribute(demo, "ep_meta").get("lang")
    words = words or _json_attribute(data, "problem_info").get("language_instruction")
    return str(words) if words else None


def _json_attribute(group: Any, name: str) -> Mapping[str, Any]:
    text = group.attrs.get(name, "{}")
    try:
        text = mended_text(text) if isinstance(text, str) else text
        return parsed_json(text, name) if isinstance(text, str | bytes) else {}
    except CorruptEpisode:
        return {}
