"""Descriptions of an RLDS dataset by TensorFlow Datasets: features in `features.json`, files in `dataset_info.json`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rcs_data.convert.rlds.tfrecord import shard_name
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.json_file import read_json

_CLASSES = "tensorflow_datasets.core.features."

Spec = dict[str, Any]
"""The description of one feature."""


@dataclass(frozen=True, kw_only=True)
class Stored:
    """A feature that a dataset of others has."""

    kind: Literal["numbers", "text", "image", "other"]
    """Kind of the values; "other" cannot be imported."""
    shape: tuple[int, ...] = ()
    """Its shape; -1 where that differs between examples."""
    dtype: str = ""
    """A numpy dtype name, or "string"."""
    about: str = ""
    """The class, if it cannot be imported."""


def tensor(shape: tuple[int, ...], dtype: str) -> Spec:
    """Describe an array, or a single number with shape ()."""
    where = "tensor_feature.Tensor" if shape else "scalar.Scalar"
    return {"pythonClassName": _CLASSES + where, "tensor": {"dtype": dtype, "encoding": "none", "shape": _shape(shape)}}


def text() -> Spec:
    """Describe words."""
    return {"pythonClassName": f"{_CLASSES}text_feature.Text", "text": {}}


def image(feature: Feature) -> Spec:
    """Describe an image: colour as JPEG or PNG, depth as PNG of 16 bits with one channel."""
    shape = feature.shape if len(feature.shape) == 3 else (*feature.shape, 1)
    encoding = "jpeg" if feature.encoding == "jpeg" else "png"
    about = {"dtype": feature.dtype, "encodingFormat": encoding, "shape": _shape(shape)}
    return {"pythonClassName": f"{_CLASSES}image_feature.Image", "image": about}


def numbers(feature: Feature) -> Spec:
    """Describe a column of numbers; a `tf.train.Example` has only 32-bit floats."""
    return tensor(feature.shape, "float32" if feature.dtype.startswith("float") else feature.dtype)


def features_json(specs: Mapping[str, Spec]) -> Spec:
    """Return `features.json`, of features by path: "steps/observation/state" is per step, others per episode."""
    tree: dict[str, Any] = {}
    for path, spec in specs.items():
        *folders, name = path.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = spec
    steps = {"feature": _folder(tree.pop("steps")), "length": "-1"}
    whole = _folder(tree)
    whole["featuresDict"]["features"]["steps"] = {
        "pythonClassName": f"{_CLASSES}dataset_feature.Dataset",
        "sequence": steps,
    }
    return whole


def _folder(tree: Mapping[str, Any]) -> Spec:
    inner = {name: spec if "pythonClassName" in spec else _folder(spec) for name, spec in tree.items()}
    return {"pythonClassName": f"{_CLASSES}features_dict.FeaturesDict", "featuresDict": {"features": inner}}


def _shape(shape: tuple[int, ...]) -> Spec:
    return {"dimensions": [str(n) for n in shape]} if shape else {}


def stored_features(values: Mapping[str, Any], path: object) -> dict[str, Stored]:
    """Return what `features.json` describes, by path, such as "steps/observation/state".

    Raises:
        CorruptEpisode: It is damaged, or of another version of TensorFlow Datasets.
    """
    try:
        return dict(_leaves("", values))
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        raise CorruptEpisode(f"{path} does not describe features as TensorFlow Datasets 4.7 does: {err!r}.") from err


def _leaves(path: str, spec: Mapping[str, Any]) -> Iterator[tuple[str, Stored]]:
    kind = str(spec["pythonClassName"]).rpartition(".")[2]
    if "featuresDict" in spec:
        for name, inner in spec["featuresDict"]["features"].items():
            yield from _leaves(f"{path}/{name}" if path else str(name), inner)
    elif kind == "Dataset" and path == "steps":
        yield from _leaves(path, spec["sequence"]["feature"])
    elif kind == "Image":
        about = spec["image"]
        yield path, Stored(kind="image", shape=_dimensions(about), dtype=str(about.get("dtype") or "uint8"))
    elif kind in ("Tensor", "Scalar"):
        about = spec["tensor"]
        dtype, shape = str(about["dtype"]), _dimensions(about)
        is_text = dtype in ("string", "object")
        is_plain = str(about.get("encoding", "none")).lower() == "none" and not (is_text and shape)
        kind = "other" if not is_plain else "text" if is_text else "numbers"
        yield path, Stored(kind=kind, shape=shape, dtype=dtype, about="a tensor of its own encoding")
    elif kind == "ClassLabel":
        yield path, Stored(kind="numbers", dtype="int64")
    else:
        yield path, Stored(kind="text" if kind == "Text" else "other", about=f"a {kind}")


def _dimensions(about: Mapping[str, Any]) -> tuple[int, ...]:
    return tuple(int(n) for n in about.get("shape", {}).get("dimensions", ()))


def dataset_folder(path: Path) -> Path | None:
    """Return the only folder with a dataset: the path, a version in it, or a version of a dataset in it."""
    for pattern in ("features.json", "*/features.json", "*/*/features.json"):
        found = [file.parent for file in path.glob(pattern)] if path.is_dir() else []
        found = [folder for folder in found if (folder / "dataset_info.json").is_file()]
        if found:
            return found[0] if len(found) == 1 else None
    return None


@dataclass(frozen=True)
class Shard:
    """A file of episodes."""

    path: Path
    """The file."""
    split: str
    """The name of its split."""
    numbers: range
    """The numbers of its episodes."""


def stored_shards(folder: Path) -> list[Shard]:
    """Return the files of a dataset, split by split, whether they are there or not.

    Raises:
        InvalidSetup: They are stored in another file format.
        CorruptEpisode: The description is damaged.
    """
    path = folder / "dataset_info.json"
    about = read_json(path)
    if about.get("fileFormat", "tfrecord") != "tfrecord":
        raise InvalidSetup(f"{path} says that the files are {about['fileFormat']!r}; only tfrecord can be imported.")
    shards: list[Shard] = []
    first = 0
    try:
        for split in about["splits"]:
            lengths = [int(length) for length in split.get("shardLengths", ())]
            for i, episodes in enumerate(lengths):
                name = shard_name(f"{about['name']}-{split['name']}.tfrecord", i, len(lengths))
                if "/" in name or episodes < 0:
                    raise CorruptEpisode(f"{path} is damaged: {name!r:.80} cannot have {episodes} episodes.")
                shards.append(Shard(folder / name, str(split["name"]), range(first, first + episodes)))
                first += episodes
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        if isinstance(err, CorruptEpisode):
            raise
        raise CorruptEpisode(f"{path} is damaged: {err!r}.") from err
    return shards
