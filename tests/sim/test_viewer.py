"""The overview, from which people see a scene, has the robots in it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rcs
from rcs.devices import lookup
from rcs.envs.setup import Setup
from rcs.errors import MissingDependency
from rcs.setups.make import resolve
from rcs.sim.scene import OVERVIEW, Scene
from rcs.sim.viewer import Picture

ASPECT = 4 / 3


def seen(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return where bodies are in the overview, (bodies, 2): from -1, left and bottom, to 1; behind it, NaN."""
    camera = model.camera(OVERVIEW).id
    points = (data.xpos - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)
    half = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    depth = np.where(points[:, 2] < 0, -points[:, 2], np.nan)
    return points[:, :2] / depth[:, None] / [half * ASPECT, half]


@pytest.mark.parametrize("name", lookup.names("lab"))
def test_robots_are_in_the_middle_at_home_and_seldom_cut_at_the_top_wherever_they_are(name: str) -> None:
    robots = resolve(Setup(task="Free", robot=name)).robots
    scene = Scene.empty()
    for robot in robots:
        scene.add_robot(robot)
    model = scene.compile()
    data = mujoco.MjData(model)
    for robot in robots:
        for joint, angle in zip(robot.arm.joints, robot.arm.home, strict=True):
            data.joint(robot.prefix + joint).qpos[:] = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    of_robots = [i for i in range(model.nbody) if any(model.body(i).name.startswith(one.prefix) for one in robots)]
    assert (np.abs(seen(model, data)[of_robots]) < 0.6).all()
    random, highest_seen = np.random.default_rng(0), []
    for _ in range(300):
        for robot in robots:
            for joint, lowest, highest in zip(
                robot.arm.joints, robot.arm.joint_lower, robot.arm.joint_upper, strict=True
            ):
                data.joint(robot.prefix + joint).qpos[:] = random.uniform(lowest, highest)
        mujoco.mj_kinematics(model, data)
        highest_seen.append(seen(model, data)[of_robots, 1].max())
    assert np.quantile(highest_seen, 0.75) < 0.95


def test_a_larger_robot_is_seen_from_farther_away_and_no_wall_is_between() -> None:
    def eye(*names: str) -> NDArray[np.float64]:
        scene = Scene.empty()
        for name in names:
            for robot in resolve(Setup(task="Free", robot=name)).robots:
                scene.add_robot(robot)
        return scene.compile().camera(OVERVIEW).pos

    assert np.linalg.norm(eye("so101")) < np.linalg.norm(eye("xarm7")) < np.linalg.norm(eye("fr3"))
    assert np.linalg.norm(eye("fr3")) < np.linalg.norm(eye("dual_fr3"))
    assert np.abs(eye("dual_fr3")[1]) < 1.65


def test_without_a_display_the_page_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.sim.viewer.has_display", lambda: False)
    with rcs.make("Free") as env, pytest.raises(MissingDependency, match="rcs sim"):
        Picture(env.simulation.world).show()
