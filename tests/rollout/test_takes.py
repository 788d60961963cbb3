"""The figures of a loop: those of its periods."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from rcs.rollout.takes import LoopStatistics


def test_the_figures_of_a_loop_are_those_of_its_periods() -> None:
    statistics = LoopStatistics(50.0)
    for period, late in ((0.02, 0.0), (0.02, 0.0), (0.04, 0.02)):
        statistics.add(period, {"late": late, "ages": {"joints": 0.001 + late}})
    mean, deviation = statistics.rates
    assert mean == pytest.approx(3 / 0.08)
    assert deviation == pytest.approx(np.std([0.02, 0.02, 0.04]) * mean**2)
    assert statistics.late == 1
    assert str(statistics) == "3 steps at 37.50 ± 13.26 Hz, 1 late; oldest: joints 21 ms"
    assert np.isnan(LoopStatistics(50.0).rates[0])


def test_the_figures_of_a_loop_are_those_of_all_its_periods_and_take_no_more_room_with_every_hour() -> None:
    periods = np.random.default_rng(3).uniform(0.02, 0.05, 5000)
    statistics = LoopStatistics(30.0)
    for period in periods:
        statistics.add(float(period), {})
    mean = periods.mean()
    assert statistics.rates == pytest.approx((1 / mean, periods.std() / mean**2), rel=1e-9)
    assert len(pickle.dumps(statistics)) < 500
