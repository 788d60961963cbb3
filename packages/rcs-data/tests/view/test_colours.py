"""Colours say which number is larger."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rcs_data.view.colours import coloured


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_the_larger_number_is_never_darker(low: float, span: float) -> None:
    values = np.linspace(low - span, low + 2 * span, 200)[None]
    colours = coloured(values, (low, low + span))[0].astype(float)
    assert colours.shape == (200, 3)
    lightness = colours @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(lightness) >= -1).all()  # a step of rounding
    assert lightness[-1] > lightness[0] + 150


def test_no_number_is_black_and_no_number_else_is() -> None:
    assert not coloured(np.array([[np.nan, np.inf]]), (0, 1)).any()
    assert coloured(np.array([[0.0]]), (0, 1)).any()
    assert not coloured(np.array([[0]], np.uint16), (0, 1)).any()
    assert coloured(np.array([[1]], np.uint16), (1, 5)).any()
