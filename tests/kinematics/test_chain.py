from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest

from rcs.kinematics import IkOptions, IkStatus, kinematics_of, load
from rcs.robots.fr3.description import FR3
from rcs.robots.franka_hand.description import FRANKA_HAND
from rcs.sim.scene import LOAD, RobotPlacement, Scene
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
    scene = Scene.empty()
    scene.add_robot(RobotPlacement(name="robot", arm=arm))
    model = scene.compile()
    data = mujoco.MjData(model)
    for name, q in zip(arm.joints, home, strict=True):
        data.joint(f"robot/{name}").qpos[0] = q
    mujoco.mj_forward(model, data)
    load_body = data.body(f"robot/{LOAD}")
    assert_near(Pose(load_body.xpos, np.roll(load_body.xquat, -1)), flange)


def assert_near(pose: Pose, other: Pose) -> None:
    np.testing.assert_allclose(pose.matrix, other.matrix, rtol=0.0, atol=1e-8)
