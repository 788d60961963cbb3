from __future__ import annotations

from typing import Any

import pytest
from rcs_data import Feature, JointBounds
from rcs_data.errors import InvalidSetup

GOOD: dict[str, Any] = {
    "arm": "SO101",
    "names": ("a", "b"),
    "lower": (-1.0, -2.0),
    "upper": (1.0, 2.0),
    "velocity": (3.0, 3.0),
}


def test_limits_come_back_as_they_were_stored() -> None:
    feature = Feature(key="observation/joints", shape=(2,), dtype="float64", limits=JointBounds(**GOOD))
    assert Feature.from_json(feature.to_json()) == feature
    plain = Feature(key="observation/joints", shape=(2,), dtype="float64")
    assert plain.to_json()["limits"] is None


@pytest.mark.parametrize(
    "change", [{"lower": (1.0,)}, {"upper": (1.0, float("nan"))}, {"velocity": "33"}, {"arm": "\udcff"}]
)
def test_limits_that_make_no_sense_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup):
        JointBounds(**{**GOOD, **change})


@pytest.mark.parametrize("stored", [[], {"arm": "x"}, {**GOOD, "more": 1}, {**GOOD, "names": 3}])
def test_what_is_read_from_a_file_is_not_believed(stored: Any) -> None:
    with pytest.raises(InvalidSetup):
        Feature.from_json({"key": "joints", "shape": [2], "dtype": "float64", "limits": stored})


def test_limits_belong_to_as_many_joints() -> None:
    with pytest.raises(InvalidSetup, match="limits of 2 joints"):
        Feature(key="observation/joints", shape=(3,), dtype="float64", limits=JointBounds(**GOOD))
