"""The SO101 gripper: published figures, opening and closing; test_gripper_motion.py lifts things."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.so101 import SO101_GRIPPER
from tests.robots.published import read_figures


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return read_figures("so101")


@pytest.fixture
def gripper() -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(SO101_GRIPPER.mjcf))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def faces(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the inner faces of the moving and of the fixed pad, in the base frame [m]."""
    ((moving,), (fixed,)) = SO101_GRIPPER.pad_geoms
    points = [
        data.geom(name).xpos + side * model.geom(name).size[0] * data.geom(name).xmat.reshape(3, 3)[:, 0]
        for name, side in ((moving, -1.0), (fixed, 1.0))
    ]
    return points[0], points[1]


def test_mass_inertia_limits_and_dynamics_of_the_moving_jaw_equal_the_table(
    gripper: mujoco.MjModel,
    figures: dict[str, Any],
    inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]],
) -> None:
    row, joint_row = figures["bodies"][-1], figures["joints"][-1]
    body, joint = gripper.body("moving_jaw"), gripper.joint("gripper")
    assert body.mass[0] == row["mass"]
    np.testing.assert_array_equal(body.pos, row["position"])
    np.testing.assert_allclose(body.quat, row["quaternion_wxyz"], atol=1e-15)
    np.testing.assert_allclose(body.ipos, row["com"], atol=1e-15)
    np.testing.assert_allclose(inertia_in_body(gripper, "moving_jaw"), row["inertia"], atol=1e-12)
    assert list(joint.range) == joint_row["range"] == [*SO101_GRIPPER.joint_closed, *SO101_GRIPPER.joint_open]
    actuator = gripper.actuator(SO101_GRIPPER.actuator)
    assert list(actuator.ctrlrange) == [SO101_GRIPPER.ctrl_closed, SO101_GRIPPER.ctrl_open]
    np.testing.assert_array_equal(actuator.biasprm[:3], [0.0, -joint_row["kp"], -joint_row["kv"]])
    # Half of the servo's torque.
    np.testing.assert_allclose(gripper.jnt_actfrcrange[joint.id], [-joint_row["force"] / 2, joint_row["force"] / 2])


def test_description_and_model_agree_on_the_tcp(gripper: mujoco.MjModel) -> None:
    tcp = gripper.site(SO101_GRIPPER.tcp_site)
    np.testing.assert_array_equal(tcp.pos, SO101_GRIPPER.tcp_in_base.translation)
    x, y, z, w = SO101_GRIPPER.tcp_in_base.quaternion
    np.testing.assert_allclose(tcp.quat, [w, x, y, z], atol=1e-15)


def test_the_jaws_close_to_a_gap_of_millimetres_and_open_to_the_width(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    data.qpos[0] = SO101_GRIPPER.joint_open[0]
    mujoco.mj_forward(gripper, data)
    moving, fixed = faces(gripper, data)
    assert np.linalg.norm(moving - fixed) == pytest.approx(SO101_GRIPPER.max_width, abs=1e-3)
    data.qpos[0] = SO101_GRIPPER.joint_closed[0]
    mujoco.mj_forward(gripper, data)
    # The tips are the lower ends of the pads.
    (moving_pad,), (fixed_pad,) = SO101_GRIPPER.pad_geoms
    gap = mujoco.mj_geomDistance(
        gripper, data, gripper.geom(moving_pad).id, gripper.geom(fixed_pad).id, 0.05, np.empty(6)
    )
    assert 0.0 < gap < 0.003
    assert data.ncon == 0


def test_the_moving_pad_is_at_the_tcps_left_and_both_pads_reach_the_tcp(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    data.qpos[0] = 0.35
    mujoco.mj_forward(gripper, data)
    tcp = data.site(SO101_GRIPPER.tcp_site)
    left, right = ((face - tcp.xpos) @ tcp.xmat.reshape(3, 3) for face in faces(gripper, data))
    assert left[1] > 0.015
    assert right[1] < -0.015
    for face in (left, right):
        assert abs(face[0]) < 1e-3
        assert abs(face[2]) < 0.015


def test_the_pads_are_parallel_at_a_width_of_three_centimetres(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    data.qpos[0] = np.radians(13.5)
    mujoco.mj_forward(gripper, data)
    moving, fixed = (data.geom(name).xmat.reshape(3, 3)[:, 0] for (name,) in SO101_GRIPPER.pad_geoms)
    assert abs(moving @ fixed) == pytest.approx(1.0, abs=1e-5)
    first, second = faces(gripper, data)
    assert np.linalg.norm(first - second) == pytest.approx(0.03, abs=5e-3)


def test_the_jaw_opens_and_closes_fully_at_its_closing_speed(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    data.qpos[0] = SO101_GRIPPER.joint_open[0]
    for ctrl in (SO101_GRIPPER.ctrl_closed, SO101_GRIPPER.ctrl_open):
        data.ctrl[0] = ctrl
        mujoco.mj_step(gripper, data, nstep=200)
        moving, _ = faces(gripper, data)
        tip = np.linalg.norm(moving - data.body("moving_jaw").xpos) + 0.0133
        assert abs(data.qvel[0]) * tip == pytest.approx(SO101_GRIPPER.closing_speed, rel=0.1)
        mujoco.mj_step(gripper, data, nstep=300)
        assert data.qpos[0] == pytest.approx(ctrl, abs=1e-3)
