"""The Franka Hand model: published figures, opening and closing, and a grasp."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.franka_hand import FRANKA_HAND

AtHome = Callable[[mujoco.MjModel], mujoco.MjData]


def fingers(data: mujoco.MjData, prefix: str = "") -> NDArray[np.float64]:
    """Positions of both finger joints [m]."""
    return np.array([data.joint(prefix + joint).qpos[0] for joint in FRANKA_HAND.joints])


def pad_gap(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Distance between the inner faces of the pads along the hand's y axis [m]."""
    (left,), (right,) = FRANKA_HAND.pad_geoms
    left_face = data.geom(left).xpos[1] - model.geom(left).size[1]
    right_face = data.geom(right).xpos[1] + model.geom(right).size[1]
    return float(left_face - right_face)


def test_masses_and_inertias_equal_the_vendors_table(
    hand: mujoco.MjModel,
    figures: dict[str, Any],
    inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]],
) -> None:
    for link in figures["franka_hand"]["links"]:
        body = hand.body(link["link"])
        assert body.mass[0] == link["mass"]
        np.testing.assert_allclose(body.ipos, link["com"], atol=1e-15)
        np.testing.assert_allclose(inertia_in_body(hand, link["link"]), link["inertia_xx_yy_zz_xy_xz_yz"], atol=1e-12)


def test_description_and_model_agree(hand: mujoco.MjModel, figures: dict[str, Any]) -> None:
    assert list(FRANKA_HAND.tcp_in_base.translation) == figures["franka_hand"]["tcp_xyz"]
    np.testing.assert_array_equal(hand.site(FRANKA_HAND.tcp_site).pos, FRANKA_HAND.tcp_in_base.translation)
    yaw = 2.0 * np.arctan2(FRANKA_HAND.mount_in_flange.quaternion[2], FRANKA_HAND.mount_in_flange.quaternion[3])
    assert yaw == pytest.approx(figures["franka_hand"]["mount_rpy"][2], abs=1e-12)
    np.testing.assert_array_equal(
        hand.actuator(FRANKA_HAND.actuator).ctrlrange, [FRANKA_HAND.ctrl_closed, FRANKA_HAND.ctrl_open]
    )
    for joint, closed, opened in zip(FRANKA_HAND.joints, FRANKA_HAND.joint_closed, FRANKA_HAND.joint_open, strict=True):
        np.testing.assert_array_equal(hand.joint(joint).range, [closed, opened])


def test_the_pads_meet_in_the_middle_when_closed_and_are_a_width_apart_when_open(hand: mujoco.MjModel) -> None:
    data = mujoco.MjData(hand)
    for q, width in ((FRANKA_HAND.joint_closed, 0.0), (FRANKA_HAND.joint_open, FRANKA_HAND.max_width)):
        data.qpos[:] = q
        mujoco.mj_forward(hand, data)
        (left,), (right,) = FRANKA_HAND.pad_geoms
        assert pad_gap(hand, data) == pytest.approx(width, abs=1e-12)
        assert data.geom(left).xpos[1] == pytest.approx(-data.geom(right).xpos[1], abs=1e-12)
        assert data.ncon == 0


def test_the_tcp_lies_between_the_pads(hand: mujoco.MjModel) -> None:
    data = mujoco.MjData(hand)
    mujoco.mj_forward(hand, data)
    tcp = data.site(FRANKA_HAND.tcp_site).xpos
    for names in FRANKA_HAND.pad_geoms:
        for name in names:
            offset = np.abs(data.geom(name).xpos - tcp)
            assert offset[0] < 1e-9
            assert offset[2] < hand.geom(name).size[2] / 2


def test_an_empty_hand_closes_and_opens_fully_at_its_closing_speed(hand: mujoco.MjModel) -> None:
    data = mujoco.MjData(hand)
    data.qpos[:] = FRANKA_HAND.joint_open
    mujoco.mj_forward(hand, data)
    stroke = FRANKA_HAND.joint_open[0] - FRANKA_HAND.joint_closed[0]
    steps = round(stroke / FRANKA_HAND.closing_speed / hand.opt.timestep)
    for ctrl, goal in (
        (FRANKA_HAND.ctrl_closed, FRANKA_HAND.joint_closed),
        (FRANKA_HAND.ctrl_open, FRANKA_HAND.joint_open),
    ):
        data.ctrl[0] = ctrl
        start = fingers(data)
        mujoco.mj_step(hand, data, nstep=steps // 2)
        np.testing.assert_allclose(np.abs(fingers(data) - start), stroke / 2, rtol=0.02)
        mujoco.mj_step(hand, data, nstep=steps // 2 + 100)
        np.testing.assert_allclose(fingers(data), goal, atol=1e-4)
        assert data.ncon == 0


def test_any_opening_between_closed_and_open_can_be_commanded(hand: mujoco.MjModel) -> None:
    data = mujoco.MjData(hand)
    for opening in (0.25, 0.9, 0.5):
        data.ctrl[0] = opening
        mujoco.mj_step(hand, data, nstep=400)
        assert pad_gap(hand, data) == pytest.approx(opening * FRANKA_HAND.max_width, abs=2e-4)


def test_both_fingers_stay_coupled_when_one_is_pushed(hand: mujoco.MjModel) -> None:
    data = mujoco.MjData(hand)
    data.ctrl[0] = 0.5
    data.qpos[:] = 0.02
    data.qfrc_applied[0] = 10.0
    mujoco.mj_step(hand, data, nstep=400)
    left, right = fingers(data)
    assert abs(left - right) < 2e-4


def test_a_cuboid_is_held_by_both_pads_with_the_grasp_force(lab_with_cuboid: mujoco.MjModel, at_home: AtHome) -> None:
    model = lab_with_cuboid
    data = at_home(model)
    cuboid = data.joint("cuboid")
    # Off centre and turned: the closing fingers have to centre it. It floats until it is held.
    cuboid.qpos[:3] = data.site("hand/tcp").xpos + np.array([0.004, 0.005, 0.0])
    cuboid.qpos[3:] = [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]
    data.actuator(f"hand/{FRANKA_HAND.actuator}").ctrl[0] = FRANKA_HAND.ctrl_closed
    data.xfrc_applied[model.body("cuboid").id, 2] = 0.06 * 9.81
    mujoco.mj_step(model, data, nstep=1000)
    data.xfrc_applied[:] = 0.0
    held = cuboid.qpos.copy()
    mujoco.mj_step(model, data, nstep=500)

    force = np.zeros(6)
    by_pad = {"hand/left_pad": 0.0, "hand/right_pad": 0.0}
    for index, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, index, force)
        names = {model.geom(int(geom)).name for geom in contact.geom}
        (pad,) = names & by_pad.keys()
        by_pad[pad] += force[0]
        assert contact.dist > -1e-3
    assert list(by_pad.values()) == pytest.approx([FRANKA_HAND.grasp_force] * 2, rel=0.1)
    np.testing.assert_allclose(cuboid.qpos[:3], held[:3], atol=2e-4)
    # Both of the cuboid's faces are 32 mm apart, less what the pads give.
    assert 2.0 * fingers(data, "hand/").mean() == pytest.approx(0.032, abs=2e-3)
