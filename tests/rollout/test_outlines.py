"""Outlines of where objects go lie on the objects, once they are there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.rollout import Outlines
from rcs.rollout.outlines import COLOUR, hull


def bounds(points: Any) -> list[float]:
    """Return the least and the largest x and y of points [px]."""
    return [*np.min(points, axis=0), *np.max(points, axis=0)]


@pytest.mark.gl
@pytest.mark.parametrize("task", ["PickCuboid", "Place"])
def test_outlines_are_within_three_pixels_of_the_simulated_objects(task: str) -> None:
    cameras = rcs.Cameras(names=("side", "wrist"), image_size=(320, 240), segmentation=True)
    setup = rcs.Setup(task, cameras=cameras)
    seen = 0
    with rcs.make(setup, hardware="sim") as env, Outlines(setup) as scene:
        assert env.platform["fr3"] == "sim"
        before, _ = env.reset(seed=100)
        for seed in range(4):
            outlines = scene.seen(seed, before["frames"])["side"]
            after, _ = env.reset(seed=seed)
            assert np.array_equal(after["frames"]["side"]["extrinsics"], before["frames"]["side"]["extrinsics"])
            poses, labels = scene.poses(seed), after["frames"]["side"]["geoms"]
            for name, pose in env.simulation.object_poses().items():
                assert np.allclose(poses[name], pose)
            for name, outline in zip(poses, outlines, strict=True):
                geoms = np.flatnonzero(
                    env.simulation.world.model.geom_bodyid == env.simulation.world.model.body(name).id
                )
                rows, columns = np.nonzero(np.isin(labels, geoms + 1))
                if not len(rows):
                    continue  # a flat mark, or hidden
                seen += 1
                found = bounds(np.stack([columns, rows], axis=-1))
                assert np.abs(np.subtract(bounds(outline), found)).max() < 3.0, (seed, name)
            drawn = scene.drawn(seed, after["frames"])["side"]
            different = np.any(drawn != after["frames"]["side"]["rgb"], axis=-1)
            assert (drawn[different] == COLOUR).all()
            assert different.any()
    assert seen >= 4


def test_a_hull_has_the_outermost_points_alone_in_order() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    inner = np.array([[1.0, 1.0], [1.0, 0.0], [0.5, 1.7]])
    assert hull(np.concatenate([inner, square])).tolist() == square.tolist()


def test_a_camera_that_does_not_say_where_it_is_shows_no_outline() -> None:
    with Outlines(rcs.Setup("PickCuboid")) as outlines:
        assert outlines.seen(0, {"any": {"rgb": np.zeros((4, 4, 3), np.uint8)}}) == {}
