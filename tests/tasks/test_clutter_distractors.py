"""Distractors lie still, apart and away from what matters, and are drawn per copy."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.task import Area
from rcs.sim import Scene, World
from rcs.sim.scene import FLOOR_HEIGHT
from rcs.tasks.clutter import GAP, GREENS, MOST_DISTRACTORS, Distractors

COPIES = 16
TARGET = (np.array([0.5, 0.0]), 0.07)


def scene_of(count: int, copies: int | None = None) -> tuple[World, Distractors]:
    distractors, scene = Distractors(count), Scene.empty()
    scene.add_table()
    distractors.furnish(scene)
    world = World(scene.compile(), copies=copies, threads=2 if copies else 0)
    distractors.bind(world)
    return world, distractors


def poses(world: World) -> np.ndarray:
    return world.qpos.reshape(*world.leading, -1, 7)


def radii(world: World) -> np.ndarray:
    """Return the radius of the circle around each, (*leading, count)."""
    size = world.field("geom_size")[..., -world.qpos.shape[-1] // 7 :, :]
    radius = np.hypot(size[..., 0], size[..., 1])
    radius[..., 1::2] = size[..., 1::2, 0]
    return radius


def test_they_lie_apart_from_each_other_and_from_the_target_and_do_not_move() -> None:
    world, distractors = scene_of(6, COPIES)
    center, radius = np.tile(TARGET[0], (COPIES, 1)), TARGET[1]
    distractors.reset(EpisodeRandom(np.arange(COPIES), np.zeros(COPIES)), ..., Area(), [(center, radius)])
    world.refresh()
    start, own = poses(world).copy(), radii(world)
    assert (start[..., 2] > 0).all()
    assert (np.linalg.norm(start[..., :2] - TARGET[0], axis=-1) > radius + own + GAP).all()
    for i in range(6):
        for j in range(i):
            distance = np.linalg.norm(start[:, i, :2] - start[:, j, :2], axis=-1)
            assert (distance > own[:, i] + own[:, j] + GAP).all()
    for _ in range(60):
        world.advance()
    np.testing.assert_allclose(poses(world), start, atol=2e-3)
    np.testing.assert_allclose(poses(world)[..., :3], start[..., :3], atol=1e-4)


def test_each_copy_has_its_own_and_they_are_those_of_a_single_world() -> None:
    world, distractors = scene_of(4, 3)
    seeds = np.array([5, 6, 7])
    distractors.reset(EpisodeRandom(seeds, np.zeros(3)), ..., Area())
    assert len({tuple(pose) for pose in poses(world)[:, 0]}) == 3
    before = world.qpos.copy()
    distractors.reset(EpisodeRandom(seeds[[0, 2]], np.ones(2)), np.array([0, 2]), Area())
    np.testing.assert_array_equal(world.qpos[1], before[1])
    for copy, episode in enumerate((1, 0, 1)):
        single, others = scene_of(4)
        others.reset(EpisodeRandom(seeds[copy], episode), ..., Area())
        np.testing.assert_array_equal(single.qpos, world.qpos[copy])
        for field in ("geom_size", "geom_rgba", "body_mass", "body_inertia", "dof_M0"):
            np.testing.assert_array_equal(single.field(field), world.field(field)[copy], err_msg=field)


def test_distractors_are_strong_and_pale_but_not_green() -> None:
    world, distractors = scene_of(MOST_DISTRACTORS, COPIES)
    distractors.reset(EpisodeRandom(np.arange(COPIES), np.zeros(COPIES)), ..., Area())
    for rgba in world.field("geom_rgba")[:, -MOST_DISTRACTORS:].reshape(-1, 4):
        hue, saturation, value = colorsys.rgb_to_hsv(*rgba[:3])
        assert not GREENS[0] + 1 < 360 * hue < GREENS[1] - 1
        assert 0.55 - 1e-6 <= saturation <= 0.95 + 1e-6
        assert 0.35 - 1e-6 <= value <= 0.90 + 1e-6


def test_those_that_find_no_room_lie_on_the_floor() -> None:
    world, distractors = scene_of(3)
    distractors.reset(EpisodeRandom(0, 0), ..., Area(size=(0.01, 0.01)), [(np.array([0.5, 0.0]), 0.2)])
    heights = world.field("geom_size")[-3:, [2, 1, 2]][np.arange(3), np.arange(3)]
    np.testing.assert_allclose(poses(world)[:, 2], FLOOR_HEIGHT + heights)
    start = world.qpos.copy()
    world.refresh()
    for _ in range(30):
        world.advance()
    np.testing.assert_allclose(world.qpos, start, atol=2e-3)


def test_around_an_object_they_lie_near_it() -> None:
    world, distractors = scene_of(2, COPIES)
    middle = np.column_stack([np.full(COPIES, 0.4), np.linspace(-0.2, 0.2, COPIES)])
    random = EpisodeRandom(np.arange(COPIES), np.zeros(COPIES))
    distractors.reset(random, ..., Area(), [(middle, 0.05)], around=(middle, 0.15))
    assert (np.abs(poses(world)[..., :2] - middle[:, None]) <= 0.15 + 1e-12).all()


def test_none_at_all_adds_nothing() -> None:
    world, distractors = scene_of(0)
    distractors.reset(EpisodeRandom(0, 0), ..., Area())
    assert world.model.nq == 0


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_their_size_goes_with_the_scale(scale: float) -> None:
    distractors, scene = Distractors(2, scale=scale), Scene.empty()
    scene.add_table()
    distractors.furnish(scene)
    world = World(scene.compile())
    distractors.bind(world)
    distractors.reset(EpisodeRandom(3, 0), ..., Area())
    whole, others = scene_of(2)
    others.reset(EpisodeRandom(3, 0), ..., Area())
    np.testing.assert_allclose(world.field("geom_size")[-2:], scale * whole.field("geom_size")[-2:])
