"""A robot's own model file is made fit for a scene, or refused: its base, its weight, its lights and its floor."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.kinematics import load
from rcs.robots.description import ArmDescription, Mount
from rcs.robots.fr3 import FR3
from rcs.sim import RobotPlacement, Scene
from rcs.sim.robot_model import MAX_JOINT_SAG, check_robot, sag_of

BASE = '<body name="link0" childclass="fr3" gravcomp="1">'
Changed = Callable[[Callable[[str], str]], ArmDescription]


@pytest.fixture
def changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Changed:
    """Give the FR3 with another model file beside another module."""

    def make(change: Callable[[str], str]) -> ArmDescription:
        text = change(FR3.mjcf.read_text())
        assert text != FR3.mjcf.read_text()
        (tmp_path / "changed.xml").write_text(text)
        module = f"changed_{tmp_path.name}"
        (tmp_path / f"{module}.py").touch()
        monkeypatch.syspath_prepend(tmp_path)
        return replace(FR3, module=module, mjcf_file="changed.xml")

    return make


def scene_with(arm: ArmDescription, base_in_scene: Mount | None = None) -> Scene:
    scene = Scene.empty()
    scene.add_robot(RobotPlacement(name="robot", arm=arm, base_in_scene=base_in_scene or Mount()))
    return scene


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ('quat="0 0 0 1"', "moved by 0 m and turned by 180 degrees"),
        ('euler="0 0 1.5708"', "turned by 90 degrees"),
        ('pos="0 0.3 0.4"', "moved by 0.5 m and turned by 0 degrees"),
    ],
)
def test_a_base_with_a_pose_of_its_own_is_refused(changed: Changed, pose: str, words: str) -> None:
    arm = changed(lambda text: text.replace(BASE, BASE.replace(">", f" {pose}>")))
    with pytest.raises(InvalidSetup, match=words):
        scene_with(arm).compile()


def test_an_arm_that_is_turned_inside_of_its_base_frame_stands_as_its_file_says(changed: Changed) -> None:
    # What the error advises: an outer body without a pose.
    outer = changed(
        lambda text: text.replace(BASE, '<body name="outer" gravcomp="1">' + BASE.replace(">", ' quat="0 0 0 1">'))
        .replace("</worldbody>", "</body></worldbody>")
    )  # fmt: skip
    plain = scene_with(FR3).compile()
    turned = scene_with(replace(outer, base_body="outer")).compile()
    flanges = []
    for model in (plain, turned):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        flanges.append(data.site("robot/flange").xpos)
    np.testing.assert_allclose(flanges[0], flanges[1] * [-1.0, -1.0, 1.0], atol=1e-12)


def test_a_robot_that_a_lab_has_turned_is_where_it_was_put() -> None:
    stand = Mount(translation=(0.1, -0.2, 0.05), quaternion=(0.0, 0.0, np.sin(0.4), np.cos(0.4)))
    scene_with(FR3, stand).compile()


def test_an_arm_without_weight_compensation_is_warned_of_with_the_remedy(changed: Changed) -> None:
    arm = changed(lambda text: re.sub(r' gravcomp="1"', "", text))
    with pytest.warns(UserWarning, match='gives way by .* gravcomp="1"'):
        scene_with(arm).compile()


def test_stiffer_servos_sag_less_and_soon_not_noticeably(changed: Changed) -> None:
    robot = RobotPlacement(name="robot", arm=changed(lambda text: re.sub(r' gravcomp="1"', "", text)))
    scene = Scene.empty()
    scene.add_robot(robot)
    sags, is_warned = [], []
    for stiffness in (1.0, 2.0, 10.0):
        model = scene.spec.compile()
        model.actuator_gainprm[:, 0] *= stiffness
        model.actuator_biasprm[:, 1] *= stiffness
        sags.append(sag_of(robot, model)[0])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            check_robot(robot, model)
        is_warned.append(bool(caught))
    np.testing.assert_allclose(sags[1], sags[0] / 2)
    assert is_warned == [True, False, False]


def test_the_predicted_sag_is_where_the_simulation_comes_to_rest(changed: Changed) -> None:
    # Compensated in part, so that it sags a little: by less than what changes the lever of the weight.
    arm = changed(lambda text: text.replace('gravcomp="1"', 'gravcomp="0.5"'))
    robot = RobotPlacement(name="robot", arm=arm)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = scene_with(arm).compile()
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = arm.home
    mujoco.mj_step(model, data, nstep=2500)
    sag, _ = sag_of(robot, model)
    assert np.abs(sag).max() > MAX_JOINT_SAG / 10
    np.testing.assert_allclose(data.qpos - arm.home, sag, atol=0.05 * np.abs(sag).max())


def test_built_in_arms_do_not_sag() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene_with(FR3).compile()


def test_lights_and_a_floor_in_the_file_do_not_get_into_the_scene(changed: Changed) -> None:
    beside = '<light pos="0 0 3"/><geom name="floor" type="plane" size="1 1 0.1"/>'
    arm = changed(
        lambda text: text.replace("<worldbody>", f"<worldbody>{beside}").replace(BASE, f'{BASE}<light pos="0 0 1"/>')
    )
    model, plain = scene_with(arm).compile(), scene_with(FR3).compile()
    assert (model.nlight, model.ngeom, model.nbody) == (plain.nlight, plain.ngeom, plain.nbody)
    assert load(arm).compile().nlight == 0
