"""Records of options: what is checked, what it is called, and the way to JSON and back."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.options import INFINITE, Meta, Natural, NotNegative, Positive, Record, Share, Whole, converted


def _words(given: str | tuple[str, ...]) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else given


class Size(Record, kw_only=False):
    """A size."""

    width: Whole
    """Pixels."""
    height: Whole = 1


class Square(Size):
    """A size of its own kind."""

    rounded: bool = False


class Options(Record):
    """Options of every kind."""

    hints: ClassVar[Mapping[str, str]] = {"fps": "Use rate.", "mode=cartesian": "Use 'pose'."}

    name: str = "a"
    count: Whole = 1
    start: Natural = 0
    rate: Positive | None = 30.0
    share: Share = 0.5
    length: NotNegative = 0.0
    limit: Annotated[float, Meta(gt=0), INFINITE] = math.inf
    on: bool = False
    mode: Literal["joints", "pose"] = "joints"
    names: tuple[str, ...] = ()
    size: Size | None = None
    sizes: Mapping[str, Size] = field(default_factory=dict[str, Size])
    steps: tuple[Size, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict[str, Any])
    edge: Whole | tuple[Whole, Whole] = 3
    either: bool | str = False
    words: tuple[str, ...] = converted(
        converter=lambda given: (given,) if isinstance(given, str) else given, default=()
    )


def test_a_record_is_a_frozen_dataclass_with_keyword_arguments() -> None:
    options = Options(count=2)
    assert dataclasses.replace(options, name="b") == Options(count=2, name="b")
    assert hash(Size(2, 3)) == hash(Size(2, 3))
    assert hash(Options(more={"a": [1], "b": {}})) == hash(Options(more={"b": {}, "a": [1]}))
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.count = 3  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(TypeError):
        Options("a")  # pyright: ignore[reportCallIssue]


def test_what_to_json_writes_from_json_reads() -> None:
    options = Options(
        rate=None, names=("b",), size=Size(2), sizes={"a": Size(1, 2)}, steps=(Size(1),), more={"x": [1]}, edge=(1, 2)
    )
    assert Options.from_json(json.loads(json.dumps(options.to_json()))) == options


def test_sequences_become_tuples_and_numbers_of_numpy_those_of_python() -> None:
    options = Options(names=["a", "b"], count=np.int64(3), rate=np.float32(2), edge=np.array([4, 5]), words="a")  # pyright: ignore[reportArgumentType]
    assert options.names == ("a", "b")
    assert (type(options.count), type(options.rate), options.edge) == (int, float, (4, 5))
    assert options.words == ("a",)


def test_a_record_inside_of_a_record_may_be_of_a_subclass_and_stays_it() -> None:
    assert isinstance(Options(size=Square(1)).size, Square)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"count": 0}, "count is 0; valid: a whole number from 1."),
        ({"count": True}, "count is True; valid: a whole number from 1."),
        ({"count": 1.5}, "count is 1.5; valid: a whole number from 1."),
        ({"rate": "30"}, "rate is '30'; valid: a finite number above 0, or None."),
        ({"rate": math.nan}, "rate is nan; valid: a finite number above 0, or None."),
        ({"rate": math.inf}, "rate is inf; valid: a finite number above 0, or None."),
        ({"rate": True}, "rate is True; valid: a finite number above 0, or None."),
        ({"share": 1.5}, "share is 1.5; valid: a finite number from 0 to 1."),
        ({"limit": math.nan}, "limit is nan; valid: a number above 0."),
        ({"on": 1}, "on is 1; valid: True, False."),
        ({"mode": "joint"}, "mode is 'joint'; valid: 'joints', 'pose'. Did you mean 'joints'?"),
        ({"mode": "cartesian"}, "mode is 'cartesian'; valid: 'joints', 'pose'. Use 'pose'."),
        ({"names": "wrist"}, "Give a sequence, such as ('wrist',)."),
        ({"size": 3}, "size is 3; valid: an object of Size, or None."),
        ({"size": {"width": 0}}, "size: width is 0; valid: a whole number from 1."),
        ({"sizes": {"a": {"widht": 1}}}, "sizes: There is no option of Size named 'widht'. Did you mean 'width'?"),
        ({"edge": (1,)}, "edge is (1,); valid: a whole number from 1, or a sequence of 2, each a whole number from 1"),
        ({"edge": (0, 1)}, "edge is (0, 1); valid"),
    ],
)
def test_a_wrong_value_is_refused_in_words(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetup) as refusal:
        Options(**given)
    assert words in str(refusal.value)


@pytest.mark.parametrize(("length", "is_cut"), [(300, False), (301, True)])
def test_of_a_long_value_its_beginning_is_named(length: int, is_cut: bool) -> None:
    value = "a" * (length - 2)  # and quotation marks
    with pytest.raises(InvalidSetup) as refusal:
        Options(rate=value)
    named = str(refusal.value).partition("; valid")[0].removeprefix("rate is ")
    assert named == (f"{value!r}"[:300] + "…" if is_cut else f"{value!r}")


def test_an_unknown_option_names_the_nearest_one_or_the_right_word() -> None:
    with pytest.raises(InvalidSetup, match="Did you mean 'count'"):
        Options.from_json({"cuont": 1})
    with pytest.raises(InvalidSetup, match=r"Use rate\."):
        Options.from_json({"fps": 1})
    with pytest.raises(InvalidSetup, match="valid is a mapping"):
        Options.from_json([1])  # pyright: ignore[reportArgumentType]
