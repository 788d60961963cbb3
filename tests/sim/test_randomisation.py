from __future__ import annotations

import json
import pickle
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.errors import InvalidSetup
from rcs.sim.model_fields import FieldRange
from rcs.sim.randomisation import Randomisation

FACTOR = st.tuples(st.floats(0.1, 1.0), st.floats(1.0, 3.0))
NAMES = Randomisation.names()
OFF = Randomisation.off()
STRONG = Randomisation.of("strong")
assert STRONG is not None
COUNTS = {name for name in NAMES if isinstance(getattr(OFF, name), int)}
FACTORS = {name for name in NAMES if getattr(OFF, name) == (1, 1)} - {"gripper_opening"}
SPANS = {name for name in NAMES if isinstance(getattr(OFF, name), tuple)} - FACTORS
FIELDS = st.lists(st.builds(FieldRange, st.just("geom_friction"), st.floats(0.1, 1.0), st.floats(1.0, 3.0)), max_size=1)
SPAN = st.tuples(st.floats(0.0, 0.2), st.floats(0.2, 0.5))


def values_of(name: str) -> st.SearchStrategy[Any]:
    if name in COUNTS:
        return st.integers(0, 8)
    if name in FACTORS:
        return FACTOR
    return SPAN if name in SPANS else st.floats(0.0, 0.1)


RANGES = st.builds(Randomisation, fields=FIELDS, **{name: values_of(name) for name in NAMES})


@settings(max_examples=50, deadline=None)
@given(ranges=RANGES)
def test_json_and_pickle_give_the_same_ranges_back(ranges: Randomisation) -> None:
    assert Randomisation.from_json(json.loads(json.dumps(ranges.to_json(), allow_nan=False))) == ranges
    assert pickle.loads(pickle.dumps(ranges)) == ranges
    assert hash(Randomisation.from_json(ranges.to_json())) == hash(ranges)


def test_the_default_varies_everything_but_adds_no_distractors_and_off_varies_nothing() -> None:
    assert [name for name in NAMES if not Randomisation().varies(name)] == ["distractors"]
    assert all(STRONG.varies(name) for name in NAMES)
    assert not any(Randomisation.off().varies(name) for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_off_varies_what_is_given(name: str) -> None:
    ranges = Randomisation.off(**{name: getattr(STRONG, name)})
    assert [other for other in NAMES if ranges.varies(other)] == [name]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(
            (name, value)
            for name in sorted(FACTORS)
            for value in (1.0, (1.0,), (1.2, 0.8), (0.0, 1.0), (-1, 1), "11", None)
        ),
        *((name, float("nan")) for name in NAMES),
        *((name, -0.1) for name in NAMES if name not in FACTORS),
        *((name, (0.2, 0.1)) for name in sorted(SPANS)),
        *((name, (0.0, 2.0)) for name in sorted(SPANS)),
        *((name, 0.1) for name in sorted(SPANS)),
        ("robot_start", 2.0),
        ("table_height", 0.5),
        ("late_actions", 1.0),
        ("distractors", 17),
        ("distractors", True),
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


def test_what_json_does_not_name_does_not_vary() -> None:
    assert Randomisation.from_json({"friction": [0.5, 2.0]}) == Randomisation.off(friction=(0.5, 2.0))


def widths(ranges: Randomisation | None, name: str) -> float:
    assert ranges is not None
    low, high = ranges.bounds(name)
    return high - low


def test_presets_are_found_by_name_and_each_varies_no_less_than_the_one_before() -> None:
    assert Randomisation.of("none") is None
    mild, usual, strong = (Randomisation.of(name) for name in ("mild", "default", "strong"))
    assert usual == Randomisation()
    for name in NAMES:
        least, middle, most = (widths(ranges, name) for ranges in (mild, usual, strong))
        assert least <= middle <= most, name
        if middle and name != "late_actions":  # which `mild` has not, and `strong` often
            assert 0.3 < least / middle < 0.7, f"about half the default {name}"
            assert 1.4 < most / middle < 3.1, f"about twice the default {name}"
    with pytest.raises(InvalidSetup, match=r"'wild'.*'none', 'mild', 'default', 'strong'"):
        Randomisation.of("wild")
