"""Labs are data: ids agree with them, and an arm without a lab gets a plain one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rcs
from rcs.devices import lookup
from rcs.envs.task import Area
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.camera import CameraMount
from rcs.robots.fr3 import FR3
from rcs.robots.mount import Mount, Obstacle
from rcs.setups.ids import ids
from rcs.setups.lab import Lab, Stand, lab_of, looking, plain_lab
from rcs.setups.resolve import resolve
from rcs.spatial import Pose


def test_the_ids_are_those_of_the_labs() -> None:
    assert {robot for _, robot in ids().values()} == set(lookup.names("lab"))
    assert {task for task, _ in ids().values()} == set(lookup.names("task"))


@pytest.mark.parametrize("name", lookup.names("lab"))
def test_every_camera_of_a_lab_can_be_asked_for(name: str) -> None:
    lab = lab_of(name)
    env = rcs.make("Free", robot=name, cameras=tuple(lab.cameras))
    assert set(env.observation_space["frames"].spaces) == set(lab.cameras)
    env.close()


def test_an_arm_without_a_lab_gets_a_plain_one() -> None:
    lab = plain_lab("other", dataclasses.replace(FR3, name="other"))
    assert [stand.arm for stand in lab.stands] == ["other"]
    assert lab.end_effector is None
    assert lab.area.center[0] < FR3.workspace_reach


def test_an_unknown_robot_gets_the_nearest_name() -> None:
    with pytest.raises(UnknownName, match="dual_fr3"):
        lab_of("dual_fr4")


def test_a_bare_flange_can_be_asked_for() -> None:
    env = rcs.make("Free", robot="fr3", end_effector="none", control="tquat", relative=False)
    observation, _ = env.reset(seed=0)
    assert set(env.action_space.spaces) == {"tquat"}
    assert "gripper" not in observation


def test_a_camera_on_a_gripper_that_is_not_there_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="which has none"):
        rcs.make("Free", robot="fr3", end_effector="none", cameras=("wrist",))


def test_a_camera_on_the_gripper_of_a_robot_that_is_not_there_is_refused_with_those_that_are() -> None:
    mount = CameraMount(camera="realsense_d405", optical=Mount(), on_gripper_of="fr3")
    cameras = rcs.Cameras(names=("hand",), mounts={"hand": mount})
    with pytest.raises(UnknownName, match=r"named 'fr3'\. Known: left, right\. Camera 'hand'"):
        rcs.make("Free", robot="dual_fr3", cameras=cameras)


def test_a_camera_of_ones_own_may_be_on_another_gripper_than_the_usual_one() -> None:
    mount = CameraMount(camera="realsense_d405", optical=Mount(), on_gripper_of="fr3")
    setup = rcs.Setup("Free", robot="fr3", end_effector="robotiq_2f85", cameras={"hand": mount})
    (camera,) = resolve(setup).cameras
    assert camera.parent_body.startswith("fr3/gripper/")
    with pytest.raises(InvalidSetup, match="made to be mounted on 'franka_hand'"):
        resolve(rcs.Setup("Free", robot="fr3", end_effector="robotiq_2f85", cameras="wrist"))


def test_looking_points_the_optical_axis_at_the_target_with_the_picture_upright() -> None:
    mount = looking((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    matrix = Pose(mount.translation, mount.quaternion).matrix
    np.testing.assert_allclose(matrix[:3, 2], -np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), atol=1e-12)
    assert matrix[2, 1] < 0, "the picture's y axis points down"
    assert abs(matrix[2, 0]) < 1e-12, "its x axis is level"


MY_LAB = Lab(
    stands=(Stand(name="fr3", arm=FR3),),
    end_effector="franka_hand",
    area=Area(),
    obstacles={"box": Obstacle(size=(0.1, 0.2, 0.3), pose=Mount(translation=(0.3, 0.5, 0.15)))},
)
MY_ARM = dataclasses.replace(FR3, name="mine")


def test_a_lab_of_ones_own_has_obstacles_that_stand_still() -> None:
    with rcs.make("PickCuboid", robot=MY_LAB) as env:
        assert rcs.Setup.from_json(env.setup.to_json()) == env.setup
        world = env.simulation.world
        np.testing.assert_allclose(world.model.geom("box").size, (0.05, 0.1, 0.15))
        env.reset(seed=0)
        env.step(env.action_space.sample())
        np.testing.assert_allclose(world.model.body("box").pos, (0.3, 0.5, 0.15))


def test_an_arm_that_is_a_global_variable_is_a_robot() -> None:
    setup = rcs.Setup("Free", robot=MY_ARM)
    assert str(setup.robot).endswith(":MY_ARM")
    with rcs.make(rcs.Setup.from_json(setup.to_json())) as env:
        assert list(env.platform) == ["mine"]
    with pytest.raises(InvalidSetup, match="global variable"):
        rcs.make("Free", robot=dataclasses.replace(FR3, name="nowhere"))


def test_arms_of_different_kinds_stand_side_by_side() -> None:
    with rcs.make("Free", robot={"left": "fr3", "right": "ur5e"}, end_effector={"right": "robotiq_2f85"}) as env:
        observation, _ = env.reset(seed=0)
        assert observation["left"]["joints"].shape == (7,)
        assert observation["right"]["joints"].shape == (6,)
        assert rcs.Setup.from_json(env.setup.to_json()) == env.setup
        before = observation["left"]["tquat"][1], observation["right"]["tquat"][1]
        assert all(np.isfinite(before))


def test_a_lab_beside_an_arm_is_refused_as_one() -> None:
    with pytest.raises(InvalidSetup, match="robot 'right' is the lab 'dual_fr3'; valid beside others is an arm"):
        lab_of({"left": "fr3", "right": "dual_fr3"})
