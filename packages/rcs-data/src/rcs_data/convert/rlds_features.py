"""The features of an RLDS dataset, as described in `features.json` of TensorFlow Datasets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs_data.feature import Feature

_CLASSES = "tensorflow_datasets.core.features."

Spec = dict[str, Any]
"""The description of one feature."""


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
    """Return the contents of `features.json`.

    Args:
        specs: Each feature by its path, such as "steps/observation/state"; those under "steps" are per step.
    """
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
