"""The descriptions: what they refuse, and that each agrees with its own MJCF file."""

from __future__ import annotations

import copy
import math
import pickle
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rcs.devices import ArmLimits
from rcs.errors import InvalidSetup
from rcs.robots.camera import CameraDescription
from rcs.robots.cameras import REALSENSE_D405, REALSENSE_D435, REALSENSE_D435I, USB_WEBCAM
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription, Mount
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.robotiq_2f85 import ROBOTIQ_2F85
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.robots.tactile import DIGIT, TactileDescription
from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.robots.ur5e import UR5E
from rcs.robots.xarm7 import XARM7

Description = ArmDescription | GripperDescription | HandDescription | CameraDescription | TactileDescription
ALL: list[Description] = [
    FR3,
    FRANKA_HAND,
    REALSENSE_D405,
    REALSENSE_D435,
    UR5E,
    ROBOTIQ_2F85,
    SO101,
    SO101_GRIPPER,
    XARM7,
    TILBURG_HAND,
    REALSENSE_D435I,
    USB_WEBCAM,
    DIGIT,
]
every_description = pytest.mark.parametrize("description", ALL, ids=lambda d: d.name)


@every_description
def test_the_mjcf_file_lies_next_to_the_description_and_compiles(description: Description) -> None:
    assert description.mjcf.name == f"{description.name}.xml"
    model = mujoco.MjModel.from_xml_path(str(description.mjcf))
    assert model.body(description.base_body).parentid[0] == 0


@every_description
def test_a_description_survives_pickling_and_copying(description: Description) -> None:
    assert pickle.loads(pickle.dumps(description)) == description
    assert copy.deepcopy(description) == description


@every_description
def test_what_is_seen_does_not_touch_and_what_touches_is_not_seen(description: Description) -> None:
    model = mujoco.MjModel.from_xml_path(str(description.mjcf))
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    assert set(model.geom_group) == {2, 3}
    assert np.array_equal(collides, model.geom_group == 3)


@every_description
def test_models_are_made_of_primitives_in_few_colours(description: Description) -> None:
    model = mujoco.MjModel.from_xml_path(str(description.mjcf))
    assert model.nmesh == model.ntex == model.nhfield == 0
    assert model.nmat <= 5
    assert not model.mat_reflectance.any()


@every_description
def test_every_body_is_free_of_its_weight(description: Description) -> None:
    model = mujoco.MjModel.from_xml_path(str(description.mjcf))
    assert np.all(model.body_gravcomp[1:] == 1.0)


@every_description
def test_names_that_scenes_add_prefixes_to_have_no_prefix_of_their_own(description: Description) -> None:
    root = ElementTree.parse(description.mjcf).getroot()
    assert all("/" not in element.get("name", "") for element in root.iter())


def test_geoms_that_cameras_see_stay_within_the_budget() -> None:
    budget = {
        "fr3": 40,
        "franka_hand": 12,
        "realsense_d405": 6,
        "realsense_d435": 9,
        "ur5e": 40,
        "robotiq_2f85": 20,
        "so101": 40,
        "so101_gripper": 12,
        "xarm7": 40,
        "tilburg_hand": 40,
        "realsense_d435i": 9,
        "usb_webcam": 6,
        "digit": 6,
    }
    for description in ALL:
        model = mujoco.MjModel.from_xml_path(str(description.mjcf))
        assert int((model.geom_group == 2).sum()) <= budget[description.name]


def test_a_mount_needs_a_unit_quaternion() -> None:
    with pytest.raises(InvalidSetup, match="norm"):
        Mount(quaternion=(0.0, 0.0, 0.0, 2.0))
    with pytest.raises(InvalidSetup, match="of 3, each a finite number"):
        Mount(translation=(0.0, math.nan, 0.0))


def test_an_arm_needs_one_entry_per_joint() -> None:
    with pytest.raises(InvalidSetup, match=r"velocity_limit is .*valid are 7 finite numbers"):
        replace(FR3, velocity_limit=(1.0,) * 6)
    with pytest.raises(InvalidSetup, match="7 actuators"):
        replace(FR3, actuators=FR3.actuators[:-1])
    with pytest.raises(InvalidSetup, match="different names"):
        replace(FR3, joints=("joint1",) * 7)


def test_an_arm_cannot_rest_outside_of_its_limits() -> None:
    with pytest.raises(InvalidSetup, match="joint4"):
        replace(FR3, home=(0.0,) * 7)


def test_an_arm_within_a_device_has_the_narrower_limits_of_both() -> None:
    lower, upper = np.array(FR3.joint_lower) + 0.1, np.array(FR3.joint_upper)
    upper[3] = FR3.home[3] - 0.2
    lower[0] -= 1.0
    device = ArmLimits(list(lower), list(upper), [9.0, *[0.1] * 6], joint_acceleration=[3.0] * 7)
    arm = FR3.within(device, "slow arm")
    np.testing.assert_array_equal(arm.joint_lower, [FR3.joint_lower[0], *lower[1:]])
    np.testing.assert_array_equal(arm.joint_upper, upper)
    np.testing.assert_array_equal(arm.velocity_limit, [FR3.velocity_limit[0], *[0.1] * 6])
    np.testing.assert_array_equal(arm.acceleration_limit, [3.0] * 7)
    assert arm.jerk_limit == FR3.jerk_limit, "unknown to the device"
    np.testing.assert_array_equal(arm.home, np.minimum(FR3.home, upper))
    assert FR3.within(ArmLimits(*[[sign * 9.0] * 7 for sign in (-1, 1, 1)]), "wide arm") == FR3


def test_an_arm_is_not_within_a_device_of_another_kind() -> None:
    with pytest.raises(InvalidSetup, match=r"small arm has 2 joints; Franka Research 3 has 7"):
        FR3.within(ArmLimits([-1.0] * 2, [1.0] * 2, [1.0] * 2), "small arm")
    with pytest.raises(InvalidSetup, match=r"bent arm moves joint4 from -0.1 to 3 rad; .* from -3.04\d* to -0.15"):
        FR3.within(ArmLimits([-0.1] * 7, [3.0] * 7, [1.0] * 7), "bent arm")


def test_a_gripper_cannot_grasp_with_more_than_its_largest_force() -> None:
    with pytest.raises(InvalidSetup, match="grasp_force"):
        replace(FRANKA_HAND, grasp_force=100.0)


def test_a_gripper_that_cannot_move_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="different ctrl"):
        replace(FRANKA_HAND, ctrl_open=FRANKA_HAND.ctrl_closed)
    with pytest.raises(InvalidSetup, match="a finite number above 0"):
        replace(FRANKA_HAND, max_width=0.0)


def test_a_hand_needs_a_target_per_joint_and_targets_within_its_range() -> None:
    with pytest.raises(InvalidSetup, match="actuator for each"):
        replace(TILBURG_HAND, actuators=TILBURG_HAND.actuators[:-1])
    with pytest.raises(InvalidSetup, match="joint_lower must be below"):
        replace(TILBURG_HAND, joint_lower=TILBURG_HAND.joint_upper)
    with pytest.raises(InvalidSetup, match=r"open_pose is .*valid are 16 finite numbers"):
        replace(TILBURG_HAND, open_pose=(0.5,) * 15)
    with pytest.raises(InvalidSetup, match=r"fist.*from 0 to 1"):
        replace(TILBURG_HAND, grasps={"fist": (1.1,) * 16})


def test_a_camera_needs_a_field_of_view_and_a_depth_range_that_make_sense() -> None:
    with pytest.raises(InvalidSetup, match="fovy"):
        replace(REALSENSE_D405, fovy=58.0)
    with pytest.raises(InvalidSetup, match="ascend"):
        replace(REALSENSE_D405, depth_range=(0.5, 0.07))
    with pytest.raises(InvalidSetup, match="modes"):
        replace(REALSENSE_D405, modes=())
