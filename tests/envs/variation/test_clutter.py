"""Any task can have distractors, which leave room around its objects and change nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.variation.clutter import ROOM
from rcs.sim.randomisation import Randomisation
from rcs.sim.scene import FLOOR_HEIGHT

CLUTTER = Randomisation.off(distractors=4, table_height=0.02)


def distractors(env: Any) -> np.ndarray:
    """Return the places of the distractors, (*leading, 4, 3)."""
    world = env.simulation.world
    first = [int(world.model.joint(f"distractor {i}").qposadr[0]) for i in range(4)]
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
