"""A TCP that is led from pose to pose keeps its limits and arrives."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rcs.hardware.tcp_ramp import TcpRamp
from rcs.spatial import Pose

DT = 0.004
SPEEDS, ACCELERATIONS = (0.25, 0.5), (1.0, 2.0)


def require_within_limits(poses: list[Pose]) -> None:
    """Check the speeds and accelerations of translation and rotation."""
    moves = np.diff([pose.translation for pose in poses], axis=0) / DT
    spins = np.array([(later * pose.inverse()).rotvec for pose, later in pairwise(poses)]) / DT
    for rates, speed, acceleration in zip((moves, spins), SPEEDS, ACCELERATIONS, strict=True):
        assert np.linalg.norm(rates, axis=1).max() <= speed * 1.001
        assert np.linalg.norm(np.diff(rates, axis=0), axis=1).max() / DT <= acceleration * 1.01


def test_a_pose_is_reached_on_a_straight_line_within_the_limits() -> None:
    start = Pose((0.4, 0.1, 0.3))
    goal = Pose.from_rotvec((0.6, -0.1, 0.35), (0.0, 0.6, -0.3))
    ramp = TcpRamp(start, SPEEDS, ACCELERATIONS)
    poses = [start, *(ramp.advance(goal, DT) for _ in range(1000))]
    assert poses[-1].is_close(goal, 1e-9, 1e-7)
    assert ramp.is_still
    require_within_limits(poses)
    places = np.array([pose.translation for pose in poses])
    way = (goal.translation - start.translation) / goal.distance_to(start)
    off = places - start.translation - np.outer((places - start.translation) @ way, way)
    assert np.abs(off).max() < 1e-9


def test_goals_that_jump_never_break_the_limits() -> None:
    random = np.random.default_rng(1)
    ramp = TcpRamp(Pose((0.4, 0.1, 0.3)), SPEEDS, ACCELERATIONS)
    poses: list[Pose] = []
    for _ in range(300):
        goal = Pose.from_rotvec(random.uniform(-1, 1, 3), random.uniform(-1, 1, 3))
        poses += [ramp.advance(goal, DT) for _ in range(8)]
    require_within_limits(poses)


def test_without_a_goal_it_comes_to_rest() -> None:
    ramp = TcpRamp(Pose(), SPEEDS, ACCELERATIONS)
    for _ in range(100):
        ramp.advance(Pose((1.0, 0.0, 0.0)), DT)
    before = ramp.pose
    ticks = 0
    while not ramp.is_still:
        ramp.advance(None, DT)
        ticks += 1
        assert ticks * DT < 0.3
    assert ramp.pose.distance_to(before) == pytest.approx(SPEEDS[0] ** 2 / 2, rel=0.1)
