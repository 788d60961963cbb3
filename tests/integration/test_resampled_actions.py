"""Relative actions that a dataset has combined take the robot where the single ones did."""

from __future__ import annotations

import numpy as np
from rcs_data.edit.rate import _tquat, _twist, _xyzrpy  # pyright: ignore[reportPrivateUsage]

from rcs.envs.layers.relative import shift
from rcs.spatial import Pose, distance, normalize, tquat_to_xyzrpy, xyzrpy_to_tquat


def test_rotations_are_composed_as_the_relative_layer_applies_them() -> None:
    rng = np.random.default_rng(2)
    steps = xyzrpy_to_tquat(np.concatenate([rng.normal(size=(6, 3)), rng.normal(size=(6, 3)) * 0.3], axis=1))
    start = normalize(rng.normal(size=7))
    pose = start
    for step in steps:
        pose = shift(pose, step)
    at_once = shift(start, _tquat(steps, 30.0))
    assert (np.asarray(distance(pose, at_once)) < 1e-9).all()
    np.testing.assert_allclose(shift(start, xyzrpy_to_tquat(_xyzrpy(tquat_to_xyzrpy(steps), 30.0))), at_once, atol=1e-9)
    twists = np.array([np.append(step[:3], Pose.from_tquat(step).rotvec) for step in steps])
    whole = _twist(twists * 30.0, 30.0) / 30.0 * len(twists)
    turn = Pose.from_rotvec(whole[:3], whole[3:]).tquat
    np.testing.assert_allclose(shift(start, turn), at_once, atol=1e-9)
