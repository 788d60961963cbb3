"""Facts that all episodes of a dataset share: rate, features, setup and instruction, as stored in `dataset.json`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import pyarrow as pa
from typing_extensions import Self

from rcs_data.errors import DatasetError, InvalidSetup, UnknownName
from rcs_data.files.feature import EPISODE, STEP, Feature
from rcs_data.files.json_file import leaves
from rcs_data.files.layout import check_name
from rcs_data.files.text import check_text, check_texts
from rcs_data.options import Meta, Record

SCHEMA_VERSION = 5
"""The layout on disk that this code writes and reads."""

SIM_STATE = "sim_state"
"""The column of the simulation's state, after the features."""

MERGED = "merged"
"""Key of an origin: for each source, what its episodes shared that those of the merged dataset do not."""

# Numbers in a simulation state; hundreds of robots have some ten thousand.
_LARGEST_STATE = 1 << 20
MEANING_OF_ACTIONS: Mapping[str, str | None] = {"control": None, "relative": "absolute"}
"""Keys of a setup, without which nobody knows what the numbers of an action are; and what counts if one is absent."""

Subsampling = Literal["444", "422", "420"]
Quality = Annotated[int, Meta(ge=1, le=100)]


class DatasetInfo(Record):
    """The facts that every episode of a dataset shares.

    Raises:
        InvalidSetup: A field does not make sense, or the setup is not JSON.
    """

    frequency: Annotated[float, Meta(ge=0.001, le=1e6)]
    """Control steps per second that were aimed at [Hz]; the measured times are in the rows."""
    features: tuple[Feature, ...]
    """The columns, in the order in which they are stored."""
    setup: dict[str, Any]
    """The setup that made the data, as JSON."""
    instruction: str
    """The instruction to the robot, in words; an episode may have another one."""
    schema_version: int = SCHEMA_VERSION
    """The layout on disk."""
    jpeg_quality: Quality = 95
    """1 to 100; a higher one makes larger and better images."""
    jpeg_subsampling: Subsampling = "444"
    """Chroma subsampling; "420" halves the size and blurs coloured edges."""
    sim_state_size: Annotated[int, Meta(ge=1, le=_LARGEST_STATE)] | None = None
    """Numbers in the simulation state per step; None without a simulation."""
    versions: dict[str, str] = field(default_factory=dict[str, str])
    """Versions of the recording software; informative, not compared when a recording is resumed."""
    origin: dict[str, Any] = field(default_factory=dict[str, Any])
    """Where the episodes are from, as JSON: a `collection`, or which datasets were `merged` or made a `mix`."""

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        twice = sorted(key for key, count in Counter(feature.key for feature in self.features).items() if count > 1)
        if not self.features or twice:
            raise InvalidSetup(f"Features must have different keys; twice: {twice}." if twice else "No features given.")
        check_text(self.instruction, "The instruction")
        for name, values in (("setup", self.setup), ("origin", self.origin), ("versions", self.versions)):
            try:
                json.dumps(values, allow_nan=False)
            except (TypeError, ValueError, RecursionError) as err:
                raise InvalidSetup(f"The {name} of a dataset must be JSON: {err}.") from err
            check_texts(values, f"the {name}")
        _check_origin(self.origin)

    @property
    def has_images(self) -> bool:
        """Whether a feature is an image."""
        return any(feature.is_image for feature in self.features)

    @cached_property
    def stream_schema(self) -> pa.Schema:
        """The columns of rows with their images, null where an image is that of the row before.

        Step and simulation state share a row, so a kill loses both or neither.
        """
        fields = [feature.arrow_field for feature in self.features]
        if self.sim_state_size is not None:
            fields.append(pa.field(SIM_STATE, pa.list_(pa.float64(), self.sim_state_size)))
        return pa.schema(fields)

    @cached_property
    def steps_schema(self) -> pa.Schema:
        """The columns of `steps.parquet`: episode and step, and those of `stream_schema`, an image by its number."""
        numbers = [f.with_type(pa.int32()) if pa.types.is_binary(f.type) else f for f in self.stream_schema]
        return pa.schema([pa.field(EPISODE, pa.string()), pa.field(STEP, pa.int64()), *numbers])

    def feature(self, key: str) -> Feature:
        """Return the feature with this key.

        Raises:
            InvalidSetup: There is none; the message has the nearest key and all others.
        """
        for feature in self.features:
            if feature.key == key:
                return feature
        raise InvalidSetup(UnknownName("feature of this dataset", key, (one.key for one in self.features)).message)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Build the info from what `to_json` returned.

        Raises:
            DatasetError: The layout is of another version.
            InvalidSetup: A field is missing, unknown or does not make sense.
        """
        refuse_other_schema(values.get("schema_version"), "dataset")
        return super().from_json(values)


def refuse_other_schema(version: object, what: str) -> None:
    """Raise if a file has a layout that this code does not read.

    Args:
        version: The schema version that the file states.
        what: Name of what was read, for the message.

    Raises:
        DatasetError: The version is another one.
    """
    if version != SCHEMA_VERSION or isinstance(version, bool):
        newer = isinstance(version, int) and version > SCHEMA_VERSION
        remedy = (
            "Update this library to read it." if newer else "Record it anew, or export it with the version it is of."
        )
        raise DatasetError(
            f"This {what} has schema version {version!r}, and this library reads {SCHEMA_VERSION}. {remedy}"
        )


def _check_origin(origin: Mapping[str, Any]) -> None:
    for name, part in _objects(origin, MERGED).items():
        check_name(name, "a dataset")
        if not isinstance(part, Mapping):
            raise InvalidSetup(f"The origin of a dataset has {part!r:.80} instead of an object for {name!r}.")
        _objects(part, "setup")
        _check_origin(_objects(part, "origin"))


def _objects(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = values.get(name, {})
    if not isinstance(value, Mapping):
        raise InvalidSetup(f"{name!r} of a dataset's origin is {value!r:.80}; it must be a dictionary.")
    return value


def differences(
    stored: DatasetInfo, given: DatasetInfo, *, names: tuple[str, str] = ("the dataset", "this setup")
) -> list[str]:
    """Describe in which fields two infos differ, one line each; versions are not compared.

    The differences of the setup come first, then those that follow from it.

    Args:
        stored: The info of a dataset on disk.
        given: The info of a new recording.
        names: Names to call the two by.
    """
    one, other = names
    left, right = (leaves(_comparable(info)) for info in (stored, given))
    lines: list[str] = []
    for name in sorted(left.keys() | right.keys(), key=_importance):
        if name not in right:
            lines.append(f"{name}: {one} has {left[name]!r}, which is not in {other}")
        elif name not in left:
            lines.append(f"{name}: {other} has {right[name]!r}, which is not in {one}")
        elif left[name] != right[name]:
            lines.append(f"{name}: {one} has {left[name]!r}, {other} has {right[name]!r}")
    order = [[feature.key for feature in info.features] for info in (stored, given)]
    if not lines and order[0] != order[1]:
        lines.append(f"features: {one} has the order {order[0]}, {other} has {order[1]}")
    return lines


def _importance(name: str) -> tuple[int, int, str]:
    """Return by what fields are sorted: the setup with task and robot in front, the rest, features, the origin."""
    place, _, field = name.partition(".")
    rank = {"setup": 0, "features": 2, "origin": 3}.get(place, 1)
    return rank, {"task": 0, "robot": 1}.get(field.partition(".")[0], 2), name


def feature_differences(
    stored: DatasetInfo, given: DatasetInfo, *, names: tuple[str, str] = ("the dataset", "this setup")
) -> list[str]:
    """Describe how the rows of two infos differ: features and their order, rate, state, and meaning of actions.

    Other differences of setup and instruction are ignored. Actions of which nothing is said count as absolute.

    Args:
        stored: One info.
        given: The other.
        names: Names to call the two by.
    """
    alike = replace(
        given,
        setup=stored.setup,
        origin=stored.origin,
        instruction=stored.instruction,
        jpeg_quality=stored.jpeg_quality,
        jpeg_subsampling=stored.jpeg_subsampling,
    )
    lines = differences(stored, alike, names=names)
    for key, unsaid in MEANING_OF_ACTIONS.items():
        one, other = (info.setup.get(key) or unsaid for info in (stored, given))
        if one is not None and other is not None and one != other:
            lines.append(f"setup.{key}: actions are {one!r} in {names[0]} and {other!r} in {names[1]}")
    return lines


def shared_setup(setups: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what several setups have in common."""
    first, *rest = setups
    return {key: value for key, value in first.items() if all(key in s and s[key] == value for s in rest)}


def _comparable(info: DatasetInfo) -> dict[str, Any]:
    values = json.loads(json.dumps(info.to_json()))  # as read from disk: tuples become lists, keys strings
    del values["versions"], values["schema_version"]
    # By key, so that an additional feature is one line and does not shift the rest.
    features = {feature.pop("key"): _form(feature) for feature in values.pop("features")}
    return {**values, "features": features}


def _form(feature: Mapping[str, Any]) -> str:
    unit = f" [{feature['unit']}]" if feature["unit"] else ""
    words = f" {tuple(feature['words'])}" if feature.get("words") else ""
    return f"{tuple(feature['shape'])} {feature['dtype']}{unit} {feature['encoding']}{words}"
