"""Paths: waypoints, points between them, and how much paths differ."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.planning import Path, diversity


def test_points_on_a_path_lie_at_their_share_of_the_length() -> None:
    path = Path([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]])
    assert path.length == 4.0
    np.testing.assert_allclose(path.at([0.0, 0.5, 0.75, 1.0]), [[0, 0], [2, 0], [3, 0], [3, 1]])


def test_a_path_keeps_its_own_waypoints() -> None:
    rows = np.zeros((2, 3))
    path = Path(rows)
    rows[0] = 1.0
    assert not path.waypoints.any()
    with pytest.raises(ValueError, match="read-only"):
        path.waypoints[0] = 1.0


@pytest.mark.parametrize("rows", [np.zeros((1, 3)), np.zeros(3), np.full((2, 2), np.nan)])
def test_what_is_no_path_is_refused(rows: np.ndarray) -> None:
    with pytest.raises(InvalidSetup, match="waypoints"):
        Path(rows)


def test_straight_ways_do_not_differ_whatever_their_ends_and_ways_around_do() -> None:
    straight = [Path([[0.0, 0.0], [1.0, end]]) for end in (0.0, 1.0, 2.0)]
    assert diversity(straight) == pytest.approx(0.0, abs=1e-12)
    around = [Path([[0.0, 0.0], [0.5, side], [1.0, 0.0]]) for side in (-0.5, 0.5)]
    assert diversity(around) > 0.4
    assert diversity(around) == diversity(around[::-1])
    with pytest.raises(InvalidSetup, match="at least 2"):
        diversity(around[:1])
