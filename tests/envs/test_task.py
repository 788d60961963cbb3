"""Options of tasks: typed, checked, and the same after a round trip through JSON."""

from __future__ import annotations

import json
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

import rcs
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.task import Area, Judgement, Task
from rcs.errors import InvalidSetup
from rcs.tasks import Free


class Sorting(Task):
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
        ("pieces", 2.0, "a whole number"),
        ("pieces", True, "a whole number"),
        ("gap", float("nan"), "finite"),
        ("gap", "wide", "finite"),
        ("gap", True, "finite"),
        ("is_timed", 1, "True, False"),
        ("label", 7, "a text"),
    ],
)
def test_a_value_of_the_wrong_kind_is_refused_with_what_is_valid(name: str, value: Any, valid: str) -> None:
    with pytest.raises(InvalidSetup, match=f"{name} is .*{valid}"):
        Sorting(Area(), {name: value})


def test_an_unknown_option_is_refused_with_the_names_of_all() -> None:
    with pytest.raises(InvalidSetup, match=r"task Sorting: .*'gapp'.* mean 'gap'.* gap, is_timed, label, order"):
        Sorting.parse_options({"gapp": 0.1})


@pytest.mark.parametrize("options", [3, "sparse", [("gap", 0.1)], Task.Options()])
def test_what_is_no_options_of_the_task_is_refused(options: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"valid is a Sorting\.Options"):
        Sorting.parse_options(options)


def test_places_lie_in_the_area_and_differ_between_copies() -> None:
    area = Area(center=(0.4, -0.1), size=(0.2, 0.1))
    places = area.draw_place(EpisodeRandom(np.arange(500), np.zeros(500, np.int64)), 0.5)
    assert places.shape == (500, 3)
    assert (np.abs(places - [0.4, -0.1, 0.0]) <= [0.1, 0.05, 0.5]).all()
    assert (np.ptp(places, axis=0) > [0.19, 0.095, 0.95]).all()
    np.testing.assert_array_equal(area.draw_place(EpisodeRandom(7, 0), 0.5), places[7])


class Judged(Free):
    """Judges as a test says, from the second judgement on."""

    judgement: ClassVar[Any] = None

    def bind(self, world: Any, robots: Any) -> None:
        super().bind(world, robots)
        self._world = world

    def evaluate(self) -> Any:
        began = self._world.time > 0.0
        return type(self).judgement(self._world.leading) if np.any(began) else Judgement()


def judge(make: Any, judgement: Any) -> None:
    Judged.judgement = staticmethod(judgement)
    env = make(Judged)
    try:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    finally:
        env.close()


both = pytest.mark.parametrize("make", [rcs.make, lambda task: rcs.make_vec(task, copies=3)], ids=["one", "copies"])


@both
def test_a_progress_that_is_no_number_is_refused_with_the_name_of_the_task(make: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"Judged\.evaluate leads to a reward that is not finite.*progress.*nan"):
        judge(make, lambda leading: Judgement(progress=np.full(leading, np.nan)))
    with pytest.raises(InvalidSetup, match=r"Judged\.evaluate leads to a reward that is not finite.*reward.*inf"):
        judge(make, lambda leading: Judgement(reward=np.full(leading, np.inf)))


@both
def test_a_progress_of_another_shape_is_refused(make: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"Judged\.evaluate leads to a reward of the shape \(2,.*; valid is \("):
        judge(make, lambda leading: Judgement(progress=np.zeros((2, *leading))))


@both
@pytest.mark.parametrize("judgement", [3, None, {"success": True}])
def test_what_is_no_judgement_is_refused_with_the_name_of_the_task(make: Any, judgement: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"Judged\.evaluate returned .*; valid is a Judgement"):
        judge(make, lambda leading: judgement)
