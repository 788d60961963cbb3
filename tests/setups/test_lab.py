"""Labs are data: ids agree with them, and an arm without a lab gets a plain one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rcs
from rcs.devices import lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.fr3.description import FR3
from rcs.setups.ids import ids
from rcs.setups.lab import lab_of, looking, plain_lab
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


def test_looking_points_the_optical_axis_at_the_target_with_the_picture_upright() -> None:
    mount = looking((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    matrix = Pose(mount.translation, mount.quaternion).matrix
    np.testing.assert_allclose(matrix[:3, 2], -np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), atol=1e-12)
    assert matrix[2, 1] < 0, "the picture's y axis points down"
    assert abs(matrix[2, 0]) < 1e-12, "its x axis is level"
