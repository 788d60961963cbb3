"""Any task can have distractors, which leave room around its objects and change nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.variation.clutter import ROOM
from rcs.sim.randomisation import Randomisation
from rcs.sim.scene import FLOOR_HEIGHT
from rcs.tasks.clutter import GAP, HALF_WIDTH

CLUTTER = Randomisation.off(distractors=4, table_height=0.02)


def distractors(env: Any, numbers: range = range(4)) -> np.ndarray:
    """Return the places of the distractors, (*leading, len(numbers), 3)."""
    world = env.simulation.world
    first = [int(world.model.joint(f"distractor {i}").qposadr[0]) for i in numbers]
    return np.stack([world.qpos[..., i : i + 3] for i in first], axis=-2)


@pytest.mark.parametrize(("task", "robot"), [("PickCuboid", "so101"), ("PickToy", "xarm7"), ("Place", "fr3")])
def test_distractors_stand_on_the_table_away_from_the_objects_of_the_task(task: str, robot: str) -> None:
    env: Any = rcs.make(task, robot=robot, randomisation=CLUTTER)
    on_table = 0
    for seed in range(5):
        _, info = env.reset(seed=seed)
        objects = env.simulation.task.object_poses()
        places = distractors(env)
        height = info["randomisation"]["table_height"][0]
        is_on_table = places[:, 2] > 0.5 * FLOOR_HEIGHT
        on_table += is_on_table.sum()
        for at in objects.values():
            assert (np.linalg.norm(places[is_on_table, :2] - at[:2], axis=-1) > ROOM).all()
        assert (places[is_on_table, 2] > height).all()
        before = places.copy()
        for _ in range(5):
            env.simulation.world.core.advance()
        np.testing.assert_allclose(distractors(env)[is_on_table], before[is_on_table], atol=1e-3)
    assert on_table >= 5


def test_each_copy_has_the_clutter_of_its_single_environment_and_the_task_starts_as_without() -> None:
    envs: Any = rcs.make_vec("PickCuboid", copies=3, threads=2, randomisation=CLUTTER, autoreset="Disabled")
    envs.reset(seed=4)
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    for copy in range(3):
        single: Any = rcs.make("PickCuboid", randomisation=CLUTTER)
        plain: Any = rcs.make("PickCuboid")
        for env in (single, plain):
            env.reset(seed=4 + copy)
            if copy == 1:
                env.reset()
        np.testing.assert_array_equal(single.simulation.world.states(), envs.simulation.world.states()[copy])
        at, usual = (env.simulation.object_poses()["cuboid"] for env in (single, plain))
        np.testing.assert_array_equal(at[:2], usual[:2])
        np.testing.assert_array_equal(at[3:], usual[3:])


def test_distractors_stand_beside_the_posts_and_the_distractors_of_the_task() -> None:
    options = {"obstacles": 6, "distractors": 4}
    env: Any = rcs.make("PickCuboid", task_options=options, randomisation=Randomisation.off(distractors=6))
    on_table = 0
    for seed in range(10):
        env.reset(seed=seed)
        posts = env.simulation.world.data.mocap_pos
        own, others = distractors(env), distractors(env, range(4, 10))
        is_on_table = others[:, 2] > 0.5 * FLOOR_HEIGHT
        on_table += is_on_table.sum()
        for place in others[is_on_table]:
            assert (np.linalg.norm(posts[:, :2] - place[:2], axis=-1) > np.sqrt(2.0) * HALF_WIDTH + GAP).all()
            assert (np.linalg.norm(own[:, :2] - place[:2], axis=-1) > 2 * 0.012 + GAP).all()
        every = np.concatenate([own, others])
        apart = np.linalg.norm(every[:, None, :2] - every[None, :, :2], axis=-1) + np.eye(len(every))
        assert apart.min() > 2 * 0.012 + GAP
    assert on_table >= 10


def test_a_task_with_distractors_of_its_own_takes_those_of_a_strong_randomisation() -> None:
    with rcs.make("PickCuboid", task_options={"distractors": 4}, randomisation="strong") as env:
        env.reset(seed=0)
        assert len(distractors(env, range(8))) == 8
