from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import IkOptions, IkStatus, kinematics_of, load
from rcs.robots.cameras import REALSENSE_D435
from rcs.robots.description import Description
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.sim.robot_model import LOAD
from rcs.sim.scene import RobotPlacement, Scene
from rcs.spatial import Pose


def add_tip(spec: mujoco.MjSpec) -> None:
    spec.body("link7").add_site(name="tip", pos=[0.0, 0.0, 0.3])


def test_a_model_is_completed_each_time_it_is_read() -> None:
    arm = dataclasses.replace(FR3, complete=add_tip)
    for _ in range(2):
        assert load(arm).site("tip") is not None
    assert load(FR3).site("tip") is None


def test_kinematics_know_what_was_added() -> None:
    arm = dataclasses.replace(FR3, complete=add_tip, flange_site="tip")
    home = np.array(FR3.home)
    rise = kinematics_of(FR3).forward(home).translation - kinematics_of(arm).forward(home).translation
    assert abs(rise[2] - (0.3 - 0.107)) < 1e-9  # the hand points down; the flange is 0.107 m beyond link7


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<mujoco><worldbody>", "cannot be read: XML parse error"),
        ("<mujoco><wrldbody/></mujoco>", "cannot be read: XML Error: Schema violation"),
        (None, "cannot be read: ParseXML: Error opening file"),
        ("a mesh", "cannot be compiled: Error: Error opening file 'none.stl'"),
    ],
)
def test_a_file_that_makes_no_robot_is_named_with_what_is_wrong(tmp_path: Path, text: str | None, words: str) -> None:
    file = tmp_path / "arm.xml"
    if text == "a mesh":
        text = FR3.mjcf.read_text().replace("<worldbody>", '<asset><mesh file="none.stl"/></asset><worldbody>', 1)
    if text is not None:
        file.write_text(text)
    arm = dataclasses.replace(FR3, name="mine", mjcf_file=str(file))
    with pytest.raises(InvalidSetup, match=re.escape(f"mine: {file} {words}")):
        kinematics_of(arm, FRANKA_HAND)
    with pytest.raises(InvalidSetup, match=re.escape(f"mine: {file} {words}")):
        scene_model(RobotPlacement(name="robot", arm=arm, gripper=FRANKA_HAND))


@pytest.mark.parametrize(
    ("description", "kind", "name", "near"),
    [
        (dataclasses.replace(FR3, joints=(*FR3.joints[:-1], "jont7")), "joint", "jont7", "joint7"),
        (dataclasses.replace(FR3, actuators=(*FR3.actuators[:-1], "jont7")), "actuator", "jont7", "joint7"),
        (dataclasses.replace(FR3, flange_site="flang"), "site", "flang", "flange"),
        (dataclasses.replace(FR3, base_body="lnk0"), "body", "lnk0", "link0"),
        (dataclasses.replace(FRANKA_HAND, tcp_site="tpc"), "site", "tpc", "tcp"),
        (dataclasses.replace(FRANKA_HAND, pad_geoms=(("left_pd",), ("right_pad",))), "geom", "left_pd", "left"),
        (dataclasses.replace(TILBURG_HAND, tcp_site="tpc"), "site", "tpc", "tcp"),
        (dataclasses.replace(REALSENSE_D435, camera="colur"), "camera", "colur", ""),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_name_that_the_file_lacks_is_told_with_file_and_nearest_name(
    description: Description, kind: str, name: str, near: str
) -> None:
    with pytest.raises(UnknownName) as caught:
        load(description)
    told = str(caught.value)
    assert f"There is no {kind} named {name!r}. Did you mean '{near}" in told
    assert f"The description {description.name!r} names it, and its file is {description.mjcf}" in told


def test_limits_are_those_of_the_description_where_the_file_allows_more() -> None:
    lower, upper = np.array(FR3.home) - 0.3, np.array(FR3.home) + 0.3
    kinematics = kinematics_of(dataclasses.replace(FR3, joint_lower=tuple(lower), joint_upper=tuple(upper)))
    np.testing.assert_array_equal(kinematics.joint_lower, lower)
    np.testing.assert_array_equal(kinematics.joint_upper, upper)
    far = kinematics_of(FR3).forward(np.array(FR3.home) + 0.5)
    assert kinematics_of(FR3).inverse(far, np.array(FR3.home)).status == IkStatus.ok
    nearest = kinematics.inverse(far, np.array(FR3.home), IkOptions(best_effort=True, restarts=0))
    assert (lower <= nearest.joints).all() and (nearest.joints <= upper).all()


@pytest.mark.parametrize(
    "site",
    [
        '<site name="flange" pos="0 0 0.107" quat="0.70710678118654752 0 0.70710678118654752 0"/>',
        '<site name="flange" pos="0 0 0.107" axisangle="0 1 0 1.57079632679489662"/>',
        '<site name="flange" pos="0 0 0.107" euler="0 1.57079632679489662 0"/>',
        '<site name="flange" pos="0 0 0.107" xyaxes="0 0 -1 0 1 0"/>',
        '<site name="flange" pos="0 0 0.107" zaxis="1 0 0"/>',
        '<frame pos="0 0 0.1" euler="0 0.3 0"><site name="flange" pos="-0.002068641 0 0.006687355" '
        'euler="0 1.27079632679489662 0"/></frame>',
    ],
    ids=["quat", "axisangle", "euler", "xyaxes", "zaxis", "frame"],
)
def test_a_hand_is_mounted_alike_however_the_file_gives_the_flange(site: str, tmp_path: Path) -> None:
    usual = '<site name="flange" pos="0 0 0.107" size="0.005" group="4"/>'
    text = FR3.mjcf.read_text()
    assert text.count(usual) == 1
    (tmp_path / "arm.xml").write_text(text.replace(usual, site))
    arm = dataclasses.replace(FR3, mjcf_file=str(tmp_path / "arm.xml"))
    home = np.array(FR3.home)
    turned = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    flange = kinematics_of(FR3).forward(home) * turned
    assert_near(kinematics_of(arm).forward(home), flange)
    tcp_in_flange = kinematics_of(FR3).forward(home).inverse() * kinematics_of(FR3, FRANKA_HAND).forward(home)
    assert_near(kinematics_of(arm, FRANKA_HAND).forward(home), flange * tcp_in_flange)
    model = scene_model(RobotPlacement(name="robot", arm=arm))
    data = mujoco.MjData(model)
    for name, q in zip(arm.joints, home, strict=True):
        data.joint(f"robot/{name}").qpos[0] = q
    mujoco.mj_forward(model, data)
    load_body = data.body(f"robot/{LOAD}")
    assert_near(Pose(load_body.xpos, np.roll(load_body.xquat, -1)), flange)


def assert_near(pose: Pose, other: Pose) -> None:
    np.testing.assert_allclose(pose.matrix, other.matrix, rtol=0.0, atol=1e-8)


def scene_model(robot: RobotPlacement) -> mujoco.MjModel:
    scene = Scene.empty()
    scene.add_robot(robot)
    return scene.compile()
