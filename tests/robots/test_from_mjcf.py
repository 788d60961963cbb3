"""Descriptions from model files have the figures of those that were written by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots import FR3, UR5E, XARM7, ArmDescription, arm_from_mjcf

LIMITS: dict[str, Any] = {"velocity_limit": 2.0, "acceleration_limit": 10.0, "jerk_limit": 500.0}
ARM = """<mujoco><worldbody><body name="base"><body name="link" pos="0 0 0.2">
<joint name="turn" {joint}/><geom size="0.02"/><site name="{site}" pos="0.3 0 0"/></body></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""
WHOLE = {
    "joint": 'range="-1 1" limited="true" actuatorfrcrange="-5 5"',
    "site": "flange",
    "actuator": '<position name="servo" joint="turn"/>',
}


@pytest.mark.parametrize("arm", [FR3, UR5E, XARM7], ids=lambda arm: arm.name)
def test_the_figures_of_a_built_in_arm_are_found_in_its_file(arm: ArmDescription) -> None:
    found = arm_from_mjcf(arm.mjcf, home=arm.home, flange_site=arm.flange_site, **LIMITS)
    for name in ("name", "joints", "actuators", "base_body", "home"):
        assert getattr(found, name) == getattr(arm, name)
    np.testing.assert_allclose(found.joint_lower, arm.joint_lower, atol=1e-9)
    np.testing.assert_allclose(found.joint_upper, arm.joint_upper, atol=1e-9)
    np.testing.assert_allclose(found.effort_limit, arm.effort_limit, rtol=1e-9)
    assert found.velocity_limit == (2.0,) * arm.dof
    assert found.workspace_reach == pytest.approx(arm.workspace_reach, rel=0.25)
    assert replace(found, tcp_speed=0.2).tcp_speed == 0.2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"actuator": ""}, "no actuators of joints"),
        ({"joint": 'actuatorfrcrange="-5 5"'}, r"\['turn'\] have no range"),
        ({"joint": 'range="-1 1" limited="true"'}, "no largest torque"),
        ({"site": "tip"}, r"no site 'flange' but \['tip'\]"),
        ({"joint": "nonsense"}, "cannot be read"),
        ({"actuator": '<motor name="servo" joint="turn"/>'}, r"\['servo'\] are no position actuators"),
        ({"actuator": '<velocity name="servo" joint="turn" kv="5"/>'}, r"\['servo'\] are no position actuators"),
        ({"joint": f'{WHOLE["joint"]}/><joint name="loose" type="slide"'}, r"\['loose'\] between base and flange"),
    ],
)
def test_what_a_file_lacks_is_named(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(**WHOLE))
    assert arm_from_mjcf(path, home=(0.0,), **LIMITS).dof == 1
    path.write_text(ARM.format(**{**WHOLE, **changes}))
    with pytest.raises(InvalidSetup, match=words):
        arm_from_mjcf(path, home=(0.0,), **LIMITS)


def test_a_position_actuator_may_be_damped_and_be_written_as_a_general_one(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    for actuator in (
        '<position name="servo" joint="turn" kp="50" kv="5"/>',
        '<position name="servo" joint="turn" kp="50" dampratio="1"/>',
        '<general name="servo" joint="turn" biastype="affine" gainprm="50" biasprm="0 -50 -5"/>',
    ):
        path.write_text(ARM.format(**{**WHOLE, "actuator": actuator}))
        assert arm_from_mjcf(path, home=(0.0,), **LIMITS).actuators == ("servo",)


def test_a_file_without_a_rest_pose_needs_one(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(**WHOLE))
    with pytest.raises(InvalidSetup, match="give home="):
        arm_from_mjcf(tmp_path / "arm.xml", **LIMITS)
