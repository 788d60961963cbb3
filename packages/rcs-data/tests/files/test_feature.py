"""A feature refuses what could not be stored, and survives JSON."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcs_data import Feature, JointBounds
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import DTYPES

words = st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=8)
keys = st.lists(words, min_size=1, max_size=4).map(lambda parts: "observation/" + "/".join(parts))

LIMITS: dict[str, Any] = {
    "arm": "SO101",
    "names": ("a", "b"),
    "lower": (-1.0, -2.0),
    "upper": (1.0, 2.0),
    "velocity": (3.0, 3.0),
}


@settings(max_examples=30)
@given(keys, st.lists(st.integers(1, 9), max_size=3), st.sampled_from(DTYPES), st.text(max_size=5))
def test_a_feature_survives_json(key: str, shape: list[int], dtype: str, unit: str) -> None:
    feature = Feature(key=key, shape=tuple(shape), dtype=dtype, unit=unit)
    assert Feature.from_json(feature.to_json()) == feature


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"key": ""}, "words"),
        ({"key": "observation//joints"}, "words"),
        ({"dtype": "float16"}, "valid: 'bool'"),
        ({"dtype": "object"}, "valid: 'bool'"),
        ({"shape": (0,)}, "from 1"),
        ({"encoding": "png"}, "valid: 'plain', 'held', 'jpeg', 'lossless', 'depth'"),
        ({"encoding": "jpeg"}, r"\(H, W, 3\) uint8"),
        ({"encoding": "depth"}, r"\(H, W\) uint16"),
        ({"key": "time/period"}, "single float64"),
        ({"key": "flags/frames/wrist"}, "single plain uint8"),
    ],
)
def test_what_cannot_be_stored_is_refused(changes: dict[str, Any], message: str) -> None:
    values = {"key": "observation/joints", "shape": (7,), "dtype": "float64", **changes}
    with pytest.raises(InvalidSetup, match=message):
        Feature(**values)


def test_a_description_with_an_unknown_field_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="option of Feature"):
        Feature.from_json({"key": "reward", "shape": [], "dtype": "float64", "colour": "red"})


@pytest.mark.parametrize("key", ["action/joints", "executed/joints", "reward", "terminated", "truncated", "time/x"])
def test_what_happens_in_each_row_is_not_held(key: str) -> None:
    dtype = "bool" if key in ("terminated", "truncated") else "float64"
    with pytest.raises(InvalidSetup, match="be plain, as it happens in each row anew"):
        Feature(key=key, shape=(), dtype=dtype, encoding="held")


def test_limits_come_back_as_they_were_stored() -> None:
    feature = Feature(key="observation/joints", shape=(2,), dtype="float64", limits=JointBounds(**LIMITS))
    assert Feature.from_json(feature.to_json()) == feature
    plain = Feature(key="observation/joints", shape=(2,), dtype="float64")
    assert plain.to_json()["limits"] is None


@pytest.mark.parametrize(
    "change", [{"lower": (1.0,)}, {"upper": (1.0, float("nan"))}, {"velocity": "33"}, {"arm": "\udcff"}]
)
def test_limits_that_make_no_sense_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup):
        JointBounds(**{**LIMITS, **change})


@pytest.mark.parametrize("stored", [[], {"arm": "x"}, {**LIMITS, "more": 1}, {**LIMITS, "names": 3}])
def test_what_is_read_from_a_file_is_not_believed(stored: Any) -> None:
    with pytest.raises(InvalidSetup):
        Feature.from_json({"key": "joints", "shape": [2], "dtype": "float64", "limits": stored})


def test_limits_belong_to_as_many_joints() -> None:
    with pytest.raises(InvalidSetup, match="limits of 2 joints"):
        Feature(key="observation/joints", shape=(3,), dtype="float64", limits=JointBounds(**LIMITS))
