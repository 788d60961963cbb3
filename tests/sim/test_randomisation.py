from __future__ import annotations

import dataclasses
import json
import pickle
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.errors import InvalidSetup
from rcs.sim.randomisation import FACTORS, Randomisation

FACTOR = st.tuples(st.floats(0.1, 1.0), st.floats(1.0, 3.0))
NAMES = [field.name for field in dataclasses.fields(Randomisation)]
RANGES = st.builds(
    Randomisation,
    **{name: FACTOR if name in FACTORS else st.floats(0.0, 0.4) for name in NAMES if name != "textures"},
    textures=st.integers(0, 8),
)


@settings(max_examples=50, deadline=None)
@given(ranges=RANGES)
def test_json_and_pickle_give_the_same_ranges_back(ranges: Randomisation) -> None:
    assert Randomisation.from_json(json.loads(json.dumps(ranges.to_json(), allow_nan=False))) == ranges
    assert pickle.loads(pickle.dumps(ranges)) == ranges
    assert hash(Randomisation.from_json(ranges.to_json())) == hash(ranges)


def test_the_default_varies_everything_and_off_nothing() -> None:
    assert all(Randomisation().varies(name) for name in NAMES)
    assert not any(Randomisation.off().varies(name) for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_off_varies_what_is_given(name: str) -> None:
    ranges = Randomisation.off(**{name: getattr(Randomisation(), name)})
    assert [other for other in NAMES if ranges.varies(other)] == [name]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((name, value) for name in FACTORS for value in (1.0, (1.0,), (1.2, 0.8), (0.0, 1.0), (-1, 1), "11", None)),
        *((name, float("nan")) for name in NAMES),
        *((name, -0.1) for name in NAMES if name not in FACTORS),
        ("camera_rotation", 3.0),
        ("table_colour", 1.5),
        ("light_position", True),
        ("textures", 1.5),
        ("textures", 1000),
    ],
)
def test_a_range_that_makes_no_sense_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=field):
        Randomisation(**{field: value})


def test_an_unknown_field_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InvalidSetup, match=r"colour.*object_mass"):
        Randomisation.from_json({"colour": 1.0})
