"""Posts around the cuboid."""

from __future__ import annotations

from contextlib import closing

import mujoco
import numpy as np
import pytest

import rcs
from rcs.errors import InvalidSetup
from rcs.sim.scene import FLOOR_HEIGHT
from rcs.tasks.clutter import FARTHEST, HALF_HEIGHT, NEAREST


def posts(world: rcs.sim.World) -> np.ndarray:
    model = world.model
    which = [model.body(f"obstacle {i}").mocapid[0] for i in range(4)]

    return world.core.component(mujoco.mjtState.mjSTATE_MOCAP_POS.value).reshape(*world.leading, -1, 3)[..., which, :]


def test_posts_stand_around_the_cuboid_and_leave_everything_else_as_it_is() -> None:
    with (
        rcs.make("PickCuboid", robot="fr3") as bare,
        rcs.make("PickCuboid", robot="fr3", task_options={"obstacles": 4}) as env,
    ):
        for seed in range(5):
            plain, with_posts = bare.reset(seed=seed)[1], env.reset(seed=seed)[1]
            np.testing.assert_array_equal(plain["cuboid"], with_posts["cuboid"])
            apart = np.linalg.norm(posts(env.simulation.world)[:, :2] - with_posts["cuboid"][:2], axis=1)
            standing = posts(env.simulation.world)[:, 2] > 0.0
            assert standing.any()
            assert (apart[standing] >= NEAREST - 1e-9).all()
            assert (apart[standing] <= FARTHEST + 1e-9).all()


def test_a_post_stands_on_the_table_or_where_there_is_no_room_on_the_floor() -> None:
    with rcs.make("PickCuboid", robot="fr3", task_options={"obstacles": 8}) as env:
        env.reset(seed=0)
        height = env.simulation.world.core.component(mujoco.mjtState.mjSTATE_MOCAP_POS.value).reshape(-1, 3)[:, 2]
        bottoms = height - HALF_HEIGHT
        assert (np.isclose(bottoms, 0.0) | np.isclose(bottoms, FLOOR_HEIGHT)).all()
        assert np.isclose(bottoms, 0.0).any()


def test_copies_have_the_posts_of_single_environments() -> None:
    options = {"robot": "fr3", "task_options": {"obstacles": 4}}
    with closing(rcs.make_vec("PickCuboid", copies=3, **options)) as batch, rcs.make("PickCuboid", **options) as env:
        batch.reset(seed=5)
        for i in range(3):
            env.reset(seed=5 + i)
            np.testing.assert_array_equal(posts(batch.simulation.world)[i], posts(env.simulation.world))


@pytest.mark.parametrize("count", [-1, 9])
def test_a_number_of_posts_that_does_not_fit_is_refused(count: int) -> None:
    with pytest.raises(InvalidSetup, match="obstacles"):
        rcs.make("PickCuboid", task_options={"obstacles": count})


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101"])
def test_posts_leave_the_robot_room_at_home(robot: str) -> None:
    with rcs.make("PickCuboid", robot=robot, task_options={"obstacles": 8}) as env:
        model, data = env.simulation.world.model, env.simulation.world.data
        names = np.array([model.body(body).name for body in model.geom_bodyid])
        post = np.char.startswith(names, "obstacle")
        arm = np.char.startswith(names, robot)
        for seed in range(40):
            env.reset(seed=seed)
            mujoco.mj_collision(model, data)
            contacts = data.contact.geom[: data.ncon]
            assert not (post[contacts].any(axis=1) & arm[contacts].any(axis=1)).any()
