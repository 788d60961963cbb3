"""Options of tasks: typed, checked, and the same after a round trip through JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest

from rcs.envs.draws import Draws
from rcs.envs.task import Area, Judgement, Task
from rcs.errors import InvalidSetup


class Sorting(Task):
    @dataclass(frozen=True, kw_only=True)
    class Options(Task.Options):
        order: Literal["colour", "size"] = "colour"
        pieces: int = 3
        gap: float = 0.05
        is_timed: bool = False
        label: str = ""

    def bind(self, world: Any, robots: Any) -> None: ...

    def reset(self, draws: Any, where: Any) -> None: ...

    def evaluate(self) -> Judgement:
        return Judgement()


def test_options_survive_json() -> None:
    options = Sorting.parse_options({"order": "size", "pieces": 5})
    assert Sorting.parse_options(json.loads(json.dumps(options.to_json()))) == options
    assert Sorting.parse_options(options) is options


def test_without_options_a_task_has_its_defaults() -> None:
    assert Sorting(Area()).options == Sorting.Options() == Sorting.parse_options({})


@pytest.mark.parametrize(
    ("name", "value", "valid"),
    [
        ("order", None, "'colour', 'size'"),
        ("pieces", 2.0, "int"),
        ("pieces", True, "int"),
        ("gap", float("nan"), "finite"),
        ("gap", "wide", "finite"),
        ("gap", True, "finite"),
        ("is_timed", 1, "bool"),
        ("label", 7, "str"),
    ],
)
def test_a_value_of_the_wrong_kind_is_refused_with_what_is_valid(name: str, value: Any, valid: str) -> None:
    with pytest.raises(InvalidSetup, match=f"{name} is .*{valid}"):
        Sorting(Area(), {name: value})


def test_an_unknown_option_is_refused_with_the_names_of_all() -> None:
    with pytest.raises(InvalidSetup, match=r"Sorting has no options \['gapp'\]; valid: order, pieces, gap"):
        Sorting.parse_options({"gapp": 0.1})


@pytest.mark.parametrize("options", [3, "sparse", [("gap", 0.1)], Task.Options()])
def test_what_is_no_options_of_the_task_is_refused(options: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"valid is a Sorting\.Options"):
        Sorting.parse_options(options)


def test_places_lie_in_the_area_and_differ_between_copies() -> None:
    area = Area(center=(0.4, -0.1), size=(0.2, 0.1))
    places = area.draw_place(Draws(np.arange(500), np.zeros(500, np.int64)), 0.5)
    assert places.shape == (500, 3)
    assert (np.abs(places - [0.4, -0.1, 0.0]) <= [0.1, 0.05, 0.5]).all()
    assert (np.ptp(places, axis=0) > [0.19, 0.095, 0.95]).all()
    np.testing.assert_array_equal(area.draw_place(Draws(7, 0), 0.5), places[7])
