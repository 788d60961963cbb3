"""Logs of virtual robots: what is written is what is read."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.virtual import read_points, read_ticks
from rcs.virtual.robot_log import RobotLog


def test_points_are_read_as_they_came_by_robot(tmp_path):
    log = RobotLog(tmp_path / "log.jsonl", {"left": 2, "right": 3})
    nothing = np.full(2, np.nan)
    log.point("left", np.array([0.1, 0.2]), nothing)
    log.point("left", nothing, np.array([3.0, -4.0]))
    log.point("right", np.ones(3), np.full(3, np.nan))
    log.close()
    points = read_points(tmp_path / "log.jsonl", "left")
    np.testing.assert_array_equal(points["joints"], [[0.1, 0.2], [np.nan, np.nan]])
    np.testing.assert_array_equal(points["torques"], [[np.nan, np.nan], [3.0, -4.0]])
    assert (np.diff(points["time"]) >= 0).all()
    np.testing.assert_array_equal(read_points(tmp_path / "log.jsonl", "right")["joints"], [[1.0, 1.0, 1.0]])
    assert len(read_ticks(tmp_path / "log.jsonl", "left")) == 0
    with pytest.raises(KeyError):
        read_points(tmp_path / "log.jsonl", "middle")
