"""Maps the contents of an HDF5 file for robomimic to features.

Our exports list their features. In other files, `obs/<name>` becomes `observation/<name>`, images
`observation/frames/<camera>/rgb` or, of uint16, `.../depth`; `actions` become `action/action`, `rewards` `reward`,
`dones` `terminated`, `states` `simulation/states`; other data per step become `imported/<name>`. An episode's success
is known only if the file has a mask "success" or "failure".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rcs_data.convert.options import ImportOptions, stored_as
from rcs_data.convert.provenance import checked_provenance
from rcs_data.convert.robomimic import PROVENANCE, RCS
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.json_file import parsed_json
from rcs_data.text import mended_text

_MOST_NAMES = 1 << 20
_KNOWN = ("obs", "next_obs", "rewards", "dones", "states", RCS)


@dataclass(frozen=True, kw_only=True)
class Column:
    """The place of a feature in an episode of the file."""

    feature: Feature
    """The feature that it becomes."""
    path: str
    """The array with its rows."""
    after: str | None = None
    """The array of observations after each step, if any."""
    is_whole: bool = False
    """Whether there is a row for the reset and one after each step, as in our exports."""

    @property
    def is_done(self) -> bool:
        """Whether a row describes what a step did, not the observation before."""
        return self.feature.is_unknown_at_reset or self.feature.key == "terminated"

    @property
    def is_repeated(self) -> bool:
        """Whether the file has no value for the last row."""
        return not (self.is_whole or self.is_done or self.after)


@dataclass(frozen=True, kw_only=True)
class SourcePlan:
    """How to import a file."""

    info: DatasetInfo
    """The info of the dataset."""
    columns: tuple[Column, ...]
    """A column per feature, in order."""
    states: str | None = None
    """The array of simulation states, if it is from RCS."""


@dataclass(frozen=True, kw_only=True)
class DemoAbout:
    """The fields of an episode other than its rows."""

    id: str
    """Its id in the dataset."""
    instruction: str
    """What the robot was asked to do."""
    seed: int | None = None
    """The seed it was reset with."""
    success: bool | None = None
    """Whether it succeeded."""
    outcome: dict[str, Any] = field(default_factory=dict[str, Any])
    """What else is known about how it went."""
    provenance: dict[str, Any] | None = None
    """Its origin, if RCS exported it."""


def demo_names(file: Any) -> list[str]:
    """Return the episodes of a file, "demo_10" after "demo_9".

    Raises:
        InvalidSetup: There are none.
    """
    names = list(file["data"]) if "data" in file and hasattr(file["data"], "keys") else []
    if not names:
        raise InvalidSetup(f"{file.filename} is not a file for robomimic: it has no episodes in a group 'data'.")
    return sorted(names, key=lambda name: (int((re.findall(r"\d+$", name) or ["0"])[0]), name))


def source_plan(file: Any, options: ImportOptions) -> SourcePlan:
    """Return how to import a file.

    Args:
        file: The open file.
        options: How to store images, and what the file does not say.

    Raises:
        InvalidSetup: It is not a file for robomimic, or its rate is neither in it nor in the options.
    """
    first = file["data"][demo_names(file)[0]]
    return _own_plan(file, options) if RCS in file["data"].attrs else _foreign_plan(file, first, options)


def demo_about(file: Any, name: str, index: int, plan: SourcePlan) -> DemoAbout:
    """Return the fields of an episode other than its rows.

    Args:
        file: The open file.
        name: The episode's name there.
        index: Its number, for an id if it has none.
        plan: Has the instruction, if the episode has none.
    """
    demo = file["data"][name]
    words = plan.info.instruction
    if PROVENANCE in demo.attrs:
        came = checked_provenance(_own_attribute(file, demo, PROVENANCE), demo.name)
        return DemoAbout(
            id=came["episode"],
            instruction=came["instruction"],
            seed=came["seed"],
            success=came["success"],
            outcome=came["outcome"],
            provenance=came,
        )
    success = None
    for mask, value in (("success", True), ("successful", True), ("failure", False)):
        if name.encode() in _names_in(file, f"mask/{mask}"):
            success = value
    return DemoAbout(id=f"{index:06d}", instruction=_instruction(file["data"], demo) or words, success=success)


def _own_plan(file: Any, options: ImportOptions) -> SourcePlan:
    about = _own_attribute(file, file["data"], RCS)
    described, observations = about.get("info"), about.get("observations")
    if not isinstance(described, dict) or not isinstance(observations, dict):
        raise CorruptEpisode(f"{file.filename} is damaged: the description of its episodes is missing.")
    info = DatasetInfo.from_json(described)
    features = tuple(stored_as(feature, options) for feature in info.features)
    info = replace(info, features=features, jpeg_quality=options.jpeg_quality)
    names = {key: name for name, key in observations.items() if isinstance(key, str)}
    columns = (
        Column(feature=f, path=f"obs/{names[f.key]}", after=f"next_obs/{names[f.key]}")
        if f.key in names
        else Column(feature=f, path=f"{RCS}/{f.key}", is_whole=True)
        for f in features
    )
    return SourcePlan(info=info, columns=tuple(columns), states="states" if info.sim_state_size else None)


def _foreign_plan(file: Any, demo: Any, options: ImportOptions) -> SourcePlan:
    data = file["data"]
    environment = _json_attribute(data, "env_args")
    kwargs = environment.get("env_kwargs")
    frequency = (kwargs.get("control_freq") if isinstance(kwargs, dict) else None) or options.frequency
    if not isinstance(frequency, int | float) or not frequency:
        raise InvalidSetup(f"{file.filename} does not state its control rate; give frequency.")
    seen = demo.get("obs", {})
    arrays = {f"obs/{name}": values for name, values in seen.items()} if hasattr(seen, "items") else {}
    arrays |= {name: values for name, values in demo.items() if name not in _KNOWN}
    left_out = {path: "it is not an array of numbers" for path, values in arrays.items() if not is_numeric(values)}
    columns: list[Column] = []
    for path, values in arrays.items():
        if path in left_out:
            continue
        folder, _, name = path.rpartition("/")
        if folder:
            after = f"next_obs/{name}" if f"next_obs/{name}" in demo else None
            columns.append(Column(feature=_observation(name, values, options), path=path, after=after))
        elif name.startswith("action"):
            columns.append(
                Column(feature=_feature(f"action/{'action' if name == 'actions' else name}", values), path=path)
            )
        else:
            columns.append(Column(feature=_feature(f"imported/{name}", values), path=path))
    if "rewards" in demo:
        columns.append(Column(feature=Feature(key="reward", shape=(), dtype="float64"), path="rewards"))
    if "dones" in demo:
        columns.append(Column(feature=Feature(key="terminated", shape=(), dtype="bool"), path="dones"))
    if "states" in demo and is_numeric(demo["states"]) and demo["states"].size:
        columns.append(Column(feature=_feature("simulation/states", demo["states"]), path="states"))
    info = DatasetInfo(
        frequency=float(frequency),
        features=tuple(column.feature for column in columns),
        setup={"imported": {"format": "robomimic", "env_args": environment, "left_out": left_out}},
        instruction=_instruction(data, demo) or options.instruction or str(environment.get("env_name", "")),
        jpeg_quality=options.jpeg_quality,
    )
    return SourcePlan(info=info, columns=tuple(columns))


def _observation(name: str, values: Any, options: ImportOptions) -> Feature:
    shape = values.shape[1:]
    if values.dtype == np.uint8 and len(shape) == 3 and shape[2] == 3:
        key = f"observation/frames/{name.removesuffix('_image').removesuffix('_rgb')}/rgb"
        return stored_as(Feature(key=key, shape=shape, dtype="uint8", encoding="jpeg"), options)
    if values.dtype == np.uint16 and (len(shape) == 2 or (len(shape) == 3 and shape[2] == 1)):
        key = f"observation/frames/{name.removesuffix('_depth')}/depth"
        return Feature(key=key, shape=shape[:2], dtype="uint16", encoding="depth")
    return _feature(f"observation/{name}", values)


def _feature(key: str, values: Any) -> Feature:
    dtype = "float32" if values.dtype == np.float16 else values.dtype.newbyteorder("=").name
    return Feature(key=key, shape=values.shape[1:], dtype=dtype)


def is_numeric(values: Any) -> bool:
    """Return whether this is an array of numbers, not a group, text, or single number."""
    return getattr(values, "shape", None) is not None and values.ndim > 0 and values.dtype.kind in "fiub"


def _names_in(file: Any, path: str) -> list[Any]:
    values: Any = file.get(path)
    return list(values[()]) if getattr(values, "ndim", None) == 1 and values.size <= _MOST_NAMES else []


def _own_attribute(file: Any, group: Any, name: str) -> dict[str, Any]:
    """Return the JSON that RCS stored as an attribute of a group."""
    text = group.attrs[name]
    if not isinstance(text, str | bytes):
        raise CorruptEpisode(f"{file.filename} is damaged: {group.name} has {text!r:.80} as {name!r}.")
    return parsed_json(text, f"{file.filename}, {group.name}, {name!r}")


def _instruction(data: Any, demo: Any) -> str | None:
    """Return what the robot was asked to do, from where RoboCasa or LIBERO store it."""
    words = _json_attribute(demo, "ep_meta").get("lang")
    words = words or _json_attribute(data, "problem_info").get("language_instruction")
    return mended_text(str(words)) if words else None


def _json_attribute(group: Any, name: str) -> Mapping[str, Any]:
    text = group.attrs.get(name, "{}")
    try:
        return parsed_json(text, name) if isinstance(text, str | bytes) else {}
    except CorruptEpisode:
        return {}
