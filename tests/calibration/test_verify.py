"""A lasting offset is a drift, a single bad picture is none."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.calibration import Drift
from rcs.errors import InvalidSetup


def test_a_lasting_offset_is_a_drift_and_nothing_is_said_before_there_are_enough_pictures() -> None:
    drift = Drift(limit_px=2.0, fewest=5)
    for _ in range(4):
        drift.add(np.array([3.0, 3.5]))
    assert not drift.is_off
    drift.add(np.array([3.0]))
    assert drift.is_off and drift.pixels == pytest.approx(3.25)


def test_single_bad_pictures_and_bad_tags_are_no_drift() -> None:
    drift = Drift()
    for i in range(30):
        drift.add(np.array([0.3, 0.2, 40.0]) if i % 4 else np.array([50.0]))
        drift.add(np.array([]))
        assert not drift.is_off


def test_a_drift_that_has_gone_is_one_no_longer() -> None:
    drift = Drift(window=5)
    for error in [9.0] * 5 + [0.1] * 5:
        drift.add(np.array([error]))
    assert not drift.is_off


@pytest.mark.parametrize("options", [{"limit_px": 0.0}, {"fewest": 0}, {"window": 3, "fewest": 5}])
def test_limits_that_make_no_sense_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InvalidSetup, match="limit_px"):
        Drift(**options)  # pyright: ignore[reportArgumentType]
