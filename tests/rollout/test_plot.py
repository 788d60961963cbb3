"""A plot is well-formed, small, and has gaps where there is no value."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcs.rollout.plot import line_plot


def parse(plot: str) -> ElementTree.Element:
    return ElementTree.fromstring(plot)


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300),
    st.floats(-1e3, 1e3),
)
def test_any_numbers_make_a_drawing_inside_its_frame(values: list[float], offset: float) -> None:
    y = np.array(values)[:, None] + offset
    figure = parse(line_plot(np.arange(len(y), dtype=float), y, ["a"], x_label="step", y_label="a & b <c>"))
    (line,) = (path for path in figure.iter("path") if path.get("class") == "line")
    points = [point.split() for point in (line.get("d") or "").replace("M", "L").split("L") if point]
    assert all(0 <= float(x) <= 520 and 0 <= float(y) <= 190 for x, y in points)


def test_many_rows_make_no_larger_a_drawing() -> None:
    y = np.random.default_rng(0).normal(size=(100_000, 7))
    plot = line_plot(np.arange(len(y)) / 30, y, list("1234567"), x_label="time [s]", y_label="joints [rad]")
    assert len(plot) < 20_000


@pytest.mark.parametrize(("values", "pieces"), [([1, np.nan, 2, 3], 2), ([np.nan, 1, 2], 1), ([np.nan, np.nan], 0)])
def test_a_missing_value_is_a_gap(values: list[float], pieces: int) -> None:
    y = np.array(values, float)[:, None]
    figure = parse(line_plot(np.arange(len(y), dtype=float), y, ["a"], x_label="step", y_label="a"))
    (line,) = (path for path in figure.iter("path") if path.get("class") == "line")
    assert (line.get("d") or "").count("M") == pieces


def test_ticks_are_round_and_enclose_the_values() -> None:
    y = np.array([[-2.36], [1.57]])
    figure = parse(line_plot(np.array([0.0, 3.7]), y, ["a"], x_label="s", y_label="rad"))
    texts = [text.text for text in figure.iter("text")]
    assert texts[:4] == ["\N{MINUS SIGN}3", "\N{MINUS SIGN}2", "\N{MINUS SIGN}1", "0"]
    assert texts[6:] == ["0", "1", "2", "3"]


def test_a_line_of_one_value_is_drawn_too() -> None:
    figure = parse(line_plot(np.arange(3.0), np.ones((3, 1)), ["a"], x_label="s", y_label="m"))
    assert len(list(figure.iter("path"))) >= 3
