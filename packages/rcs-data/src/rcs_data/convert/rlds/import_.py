"""Imports RLDS: folders of TensorFlow Datasets, such as those of Open X-Embodiment, Bridge and DROID, and our exports.

In each step of datasets from elsewhere

- an image `observation/<name>` becomes `observation/frames/<name>/rgb` or, of uint16, `.../depth`; JPEGs and depth stay
  as they are; other observations become `observation/<name>`;
- `action` becomes `action/action`, and the parts of a dictionary `action/<name>`; `action_dict/<name>` keeps its name;
- `reward` stays, `is_terminal` becomes `terminated`, and `is_last` elsewhere `truncated`;
- the first words of the text named "…language_instruction" are the episode's instruction; all texts are kept per step,
  as `labels` says, in `imported/<name>`;
- other numbers, embeddings and tensors of more than 1024 numbers become `imported/<name>`.

The format has no rate. An episode has a row more than steps, as `steps` says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.images import as_stored, decode_image
from rcs_data.convert.labels import LABELS, numbered
from rcs_data.convert.observations import ACTION_DICT, camera_feature, kept_dtype, kept_info
from rcs_data.convert.options import ImportOptions, selected_numbers, stored_as
from rcs_data.convert.provenance import checked_provenance
from rcs_data.convert.rlds.export import RCS_FILE
from rcs_data.convert.rlds.features import Shard, Stored, dataset_folder, stored_features, stored_shards
from rcs_data.convert.rlds.tfrecord import Stored as Values
from rcs_data.convert.rlds.tfrecord import read_examples
from rcs_data.convert.steps import EpisodeAbout, Record, StepColumn, import_episodes, leave_out, record_steps
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.files.json_file import parsed_json, read_json
from rcs_data.files.text import mended_text
from rcs_data.read.reader import Dataset
from rcs_data.read.trajectory import VectorLayout
from rcs_data.record.writer import DatasetWriter

# More than any state of a robot; depth images as floats and the like have more.
_LARGEST_OBSERVATION = 1024
_INSTRUCTION = "language_instruction"
_LAST, _TERMINAL = "steps/is_last", "steps/is_terminal"


@dataclass(frozen=True, kw_only=True)
class _Source:
    """A column of the files, and the features in it."""

    path: str
    stored: Stored
    features: tuple[Feature, ...]


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """How to import a folder."""

    info: DatasetInfo
    sources: tuple[_Source, ...]
    texts: dict[str, Feature]
    """The features of texts, which number them."""
    has_provenance: bool


def is_rlds(path: Path) -> bool:
    """Return whether a folder has a dataset as TensorFlow Datasets stores it, or a single one in folders below."""
    return dataset_folder(path) is not None


def import_rlds(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import a folder of TensorFlow Datasets, whole or not at all.

    Args:
        source: The folder with `dataset_info.json`, or one above it that has no other.
        out: The folder of the new dataset.
        options: Says what to import, how to store images, and what the format does not say: `frequency`, which it
            needs.

    Raises:
        InvalidSetup: There is no such dataset, it is stored in another file format or has no steps, or the rate is not
            given.
        CorruptEpisode: A file is damaged, or an episode is not what `features.json` describes.
        DatasetError: `out` exists, or the disk fails.
    """
    options = options or ImportOptions()
    folder = dataset_folder(Path(source))
    if folder is None:
        raise InvalidSetup(f"{source} has no dataset of TensorFlow Datasets: no single folder with dataset_info.json.")
    shards = stored_shards(folder)
    chosen = set(selected_numbers(options.episodes, range(sum(len(shard.numbers) for shard in shards))))
    needed = [shard for shard in shards if chosen & {*shard.numbers}]
    found = [shard for shard in needed if shard.path.is_file()]
    if not found or (len(found) < len(needed) and not options.allow_missing):
        raise InvalidSetup(
            f"{folder} has {len(found)} of the {len(needed)} files with these episodes. "
            "Choose other episodes, or allow missing ones."
        )
    plan = _plan(folder, found[0], options)
    return import_episodes(out, plan.info, _episodes(needed, chosen, plan, options), options)


def _episodes(
    shards: Iterable[Shard], chosen: set[int], plan: _Plan, options: ImportOptions
) -> Iterator[tuple[int, Record]]:
    """Yield what records each episode; what cannot be read of a file is left out, if that is allowed."""
    for shard in shards:
        numbers = [number for number in shard.numbers if number in chosen]
        count = 0
        try:
            wanted = {number - shard.numbers.start for number in numbers}
            for number, example in zip(numbers, read_examples(shard.path, wanted), strict=False):
                count += 1
                yield number, partial(_record, example=example, plan=plan, index=number, split=shard.split)
            if count < len(numbers):
                raise CorruptEpisode(f"{shard.path} has only {count} of {len(numbers)} episodes.")
        except CorruptEpisode as err:
            leave_out(f"Episodes {numbers[count]} to {numbers[-1]}", err, options)


def _plan(folder: Path, first: Shard, options: ImportOptions) -> _Plan:
    described = stored_features(read_json(folder / "features.json"), folder / "features.json")
    steps = {path: stored for path, stored in described.items() if path.startswith("steps/")}
    if not steps:
        raise InvalidSetup(f"{folder} has no steps; episodes of RLDS are a dataset of steps each.")
    path, texts = folder / RCS_FILE, dict[str, Feature]()
    if path.is_file():
        sources, info = _own_sources(steps, read_json(path), path, options)
    else:
        sources, texts, info = _foreign_sources(folder, steps, next(read_examples(first.path), {}), options)
    info = kept_info(info, options)
    kept = {feature.key for feature in info.features}
    return _Plan(
        info=info,
        sources=tuple(source for source in sources if source.features[0].key in kept),
        texts=texts,
        has_provenance=path.is_file() and "episode_metadata/provenance" in described,
    )


def _own_sources(
    steps: Mapping[str, Stored], ours: Mapping[str, Any], path: Path, options: ImportOptions
) -> tuple[list[_Source], DatasetInfo]:
    """Return the columns of an export of ours, which lists its features."""
    try:
        info = DatasetInfo.from_json(ours["info"])
        info = replace(info, features=tuple(stored_as(feature, options) for feature in info.features))
        sources = [
            _Source(path=name, stored=steps[name], features=(info.feature(key),))
            for name, key in ours["columns"].items()
        ]
        action = tuple(info.feature(part["key"]) for part in ours["action"])
        sources.append(_Source(path="steps/action", stored=steps["steps/action"], features=action))
        for key, name in (("terminated", _TERMINAL), ("truncated", _LAST)):
            if any(feature.key == key for feature in info.features):
                sources.append(_Source(path=name, stored=steps[name], features=(info.feature(key),)))
    except (KeyError, TypeError, AttributeError, InvalidSetup) as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err
    for source in sources:
        numbers = sum(feature.size for feature in source.features)
        is_image = source.stored.kind == "image"
        if is_image != source.features[0].is_image or (not is_image and numbers != int(np.prod(source.stored.shape))):
            raise CorruptEpisode(f"{path} is damaged: {source.path} is not {source.features[0].key!r}.")
    stored = {feature.key for source in sources for feature in source.features}
    features = tuple(feature for feature in info.features if feature.key in stored)
    return sources, replace(info, features=features, sim_state_size=None)


def _foreign_sources(
    folder: Path, steps: Mapping[str, Stored], example: Mapping[str, Values], options: ImportOptions
) -> tuple[list[_Source], dict[str, Feature], DatasetInfo]:
    """Return the columns of a dataset of others, and the features of its texts."""
    if not options.frequency:
        raise InvalidSetup(f"{folder} does not state its control rate, as no dataset of RLDS does; give frequency.")
    sources: list[_Source] = []
    texts: dict[str, Feature] = {}
    left_out: dict[str, str] = {}
    for path, stored in steps.items():
        name = path.removeprefix("steps/")
        try:
            if stored.kind == "text":
                texts[path] = Feature(key=f"imported/{name.rpartition('/')[2]}", shape=(), dtype="int32")
            elif name != "is_first":
                feature = _feature(name, stored, example.get(path), options)
                sources.append(_Source(path=path, stored=stored, features=(feature,)))
        except InvalidSetup as err:
            left_out[name] = str(err)
    info = DatasetInfo(
        frequency=options.frequency,
        features=(*(feature for source in sources for feature in source.features), *texts.values()),
        setup={"imported": {"format": "RLDS", "name": folder.parent.name, "left_out": left_out}},
        instruction=options.instruction or "",
        jpeg_quality=options.jpeg_quality,
    )
    return sources, texts, info


def _feature(name: str, stored: Stored, values: Values | None, options: ImportOptions) -> Feature:
    """Return the feature that a column of others becomes; InvalidSetup, with the reason, if it cannot be one."""
    folder, _, rest = name.partition("/")
    if stored.kind == "image":
        shape = stored.shape
        if min(shape, default=-1) < 1 and isinstance(values, list) and values:
            shape = (*decode_image(values[0]).shape[:2], *shape[2:])
        camera = rest if folder == "observation" and rest else name
        feature = camera_feature(camera, shape, stored.dtype, options)
        if feature is not None:
            return feature
        raise InvalidSetup(f"its images are {shape} {stored.dtype}")
    if stored.kind == "other":
        raise InvalidSetup(f"it is {stored.about}")
    dtype = kept_dtype(stored.dtype)
    if dtype is None or min(stored.shape, default=1) < 1:
        raise InvalidSetup(f"it is {stored.shape} {stored.dtype}")
    known = {"is_terminal": "terminated", "is_last": "truncated", "reward": "reward"}
    if name in known and stored.shape in ((), (1,)):
        return Feature(key=known[name], shape=(), dtype=dtype if name == "reward" else "bool")
    is_small = "embedding" not in rest and int(np.prod(stored.shape)) <= _LARGEST_OBSERVATION
    key = f"imported/{rest or name}"
    if folder == "action":
        key = f"action/{rest or 'action'}"
    elif f"{folder}/" == ACTION_DICT or (folder == "observation" and rest and is_small):
        key = name
    return Feature(key=key, shape=stored.shape, dtype=dtype)


def _record(writer: DatasetWriter, example: Mapping[str, Values], plan: _Plan, index: int, split: str) -> Iterator[int]:
    """Record an episode, and yield the number of each written row."""
    numbers: dict[str, NDArray[Any]] = {}
    for source in plan.sources:
        if source.stored.kind == "numbers":
            numbers[source.path] = _numbers(example, source.path, source.stored)
    if not numbers:
        raise CorruptEpisode("An episode has no numbers, so that its steps cannot be counted.")
    steps = {path: len(values) for path, values in numbers.items()}
    count = min(steps.values())
    if not count or max(steps.values()) != count:
        raise CorruptEpisode(f"The columns of an episode have {steps} steps; expected equal numbers of at least 1.")
    columns: list[StepColumn] = []
    for source in plan.sources:
        if source.stored.kind == "image":
            values = _images(example, source.path, source.features[0])
            columns.append(StepColumn(feature=source.features[0], values=values))
            continue
        given = numbers[source.path].reshape(count, -1)
        if source.path == _LAST and source.features[0].key == "truncated" and _TERMINAL in example:
            given = given.astype(bool) & ~_numbers(example, _TERMINAL, Stored(kind="numbers")).astype(bool)
        parts = VectorLayout(features=source.features).slices
        columns += [StepColumn(feature=f, values=_typed(given[:, parts[f.key]], f)) for f in source.features]
    labels: dict[str, list[str]] = {}
    instruction = plan.info.instruction
    for path, feature in plan.texts.items():
        words = list(islice(_words(example, path), count))
        values, labels[feature.key] = numbered(words)
        columns.append(StepColumn(feature=feature, values=values))
        if path.endswith(_INSTRUCTION):
            instruction = next(filter(None, words), instruction)
    about = _about(example, plan, index, split)
    if not plan.has_provenance:
        about = replace(about, instruction=instruction, outcome={LABELS: labels} if labels else {})
    yield from record_steps(writer, count, columns, about)


def _images(example: Mapping[str, Values], path: str, feature: Feature) -> Iterator[bytes | NDArray[Any] | None]:
    """Yield the images of an episode; None where there is none, but that of the step before."""
    values = example.get(path)
    if not isinstance(values, list):
        raise CorruptEpisode(f"An episode lacks the byte strings {path!r}, which features.json lists.")
    for data in values:
        yield as_stored(feature, data, path) if data else None


def _numbers(example: Mapping[str, Values], path: str, stored: Stored) -> NDArray[Any]:
    """Return a column, shape (steps, size)."""
    values = example.get(path)
    if values is None or isinstance(values, list):
        raise CorruptEpisode(f"An episode lacks the numbers {path!r}, which features.json lists.")
    size = int(np.prod(stored.shape, dtype=np.int64))
    if len(values) % size:
        raise CorruptEpisode(f"{path!r} has {len(values)} numbers, no multiple of the {size} of a step.")
    return values.reshape(-1, size)


def _typed(values: NDArray[Any], feature: Feature) -> NDArray[Any]:
    # The upper half of uint64 is stored as negative numbers.
    is_cast = feature.dtype == "uint64" and values.dtype == np.int64
    values = values.view(np.uint64) if is_cast else values
    if values.dtype.kind == "i" and feature.numpy_dtype.kind in "iu" and values.size:
        limits = np.iinfo(feature.dtype)
        if values.min() < limits.min or values.max() > limits.max:
            raise CorruptEpisode(f"{feature.key!r} has numbers from {values.min()} to {values.max()}.")
    return values.astype(feature.dtype)


def _about(example: Mapping[str, Values], plan: _Plan, index: int, split: str) -> EpisodeAbout:
    imported: dict[str, Any] = {"split": split, "index": index}
    if plan.has_provenance:
        text = next(_words(example, "episode_metadata/provenance"), "")
        origin = checked_provenance(parsed_json(text, "the provenance of an episode"), "episode_metadata")
        return EpisodeAbout.of_provenance(origin, imported)
    success = None
    for name in ("episode_metadata/success", "success"):
        if name in example:
            found = example[name]
            success = bool(found[0]) if len(found) == 1 and found[0] in (0, 1) else None
    for path, values in example.items():
        if path.startswith("episode_metadata/") and isinstance(values, list):
            imported[path] = next(_words(example, path), "")
    return EpisodeAbout(id=f"{index:06d}", success=success, imported=imported)


def _words(example: Mapping[str, Values], path: str) -> Iterator[str]:
    """Yield the texts of a feature; none if the episode lacks it."""
    values = example.get(path)
    for data in values if isinstance(values, list) else ():
        yield mended_text(data.decode(errors="replace"))
