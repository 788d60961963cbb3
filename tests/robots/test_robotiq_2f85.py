"""The 2F-85 model: published figures, opening and closing; test_gripper_motion.py lifts things."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.robotiq_2f85 import ROBOTIQ_2F85
from rcs.spatial import Pose
from tests.robots.published import read_figures

Bodies = dict[str, dict[str, Any]]
Rigid = tuple[float, NDArray[np.float64], NDArray[np.float64]]
"""Mass [kg], centre of mass [m] and inertia about the origin [kg m^2], in one frame."""


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return read_figures("robotiq_2f85")


@pytest.fixture(scope="module")
def published(figures: dict[str, Any]) -> Bodies:
    return {body["body"]: body for body in figures["bodies"]}


@pytest.fixture
def gripper() -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(ROBOTIQ_2F85.mjcf))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def parallel_axis(mass: float, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def rigid(published: Bodies, name: str, origin: list[float], yaw: float = 0.0) -> Rigid:
    """One published body, its frame at `origin` and turned by `yaw` in the frame of the result."""
    body = published[name]
    turned = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    xx, yy, zz, xy, xz, yz = body["inertia"]
    inertia = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
    com = np.array(origin) + turned @ body["com"]
    return body["mass"], com, inertia + parallel_axis(body["mass"], com)


def fused(*parts: Rigid) -> Rigid:
    mass = sum(part[0] for part in parts)
    return mass, sum(part[0] * part[1] for part in parts) / mass, np.sum([part[2] for part in parts], axis=0)


def of_model(model: mujoco.MjModel, name: str) -> Rigid:
    body = model.body(name)
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, body.iquat)
    turned = matrix.reshape(3, 3)
    mass = float(body.mass[0])
    return mass, body.ipos, turned @ np.diag(body.inertia) @ turned.T + parallel_axis(mass, body.ipos)


def pad_gap(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Distance between the inner faces of the pads along the base's y axis [m]."""
    (left,), (right,) = ROBOTIQ_2F85.pad_geoms
    left_face = data.geom(left).xpos[1] - model.geom(left).size[1]
    right_face = data.geom(right).xpos[1] + model.geom(right).size[1]
    return float(left_face - right_face)


def set_angle(model: mujoco.MjModel, data: mujoco.MjData, angle: float) -> None:
    for joint in ROBOTIQ_2F85.joints:
        data.joint(joint).qpos[0] = angle
    mujoco.mj_forward(model, data)


def test_masses_and_inertias_are_those_of_the_published_bodies_that_move_together(
    gripper: mujoco.MjModel, published: Bodies
) -> None:
    pad = published["right_pad"]["position"]
    origin = [0.0, 0.0, 0.0]
    expected = {
        "base": fused(
            rigid(published, "base_mount", [0.0, 0.0, 0.007], np.pi / 2), rigid(published, "base", [0.0, 0.0, 0.0108])
        ),
        "driver": fused(
            rigid(published, "right_driver", origin),
            rigid(published, "right_coupler", published["right_coupler"]["position"]),
        ),
        "knuckle": rigid(published, "right_spring_link", origin),
        "finger": fused(
            rigid(published, "right_follower", origin),
            rigid(published, "right_pad", pad),
            rigid(published, "right_silicone_pad", pad),
        ),
    }
    names = {"base": ["base"]} | {
        part: [f"{s}_{part}" for s in ("left", "right")] for part in expected if part != "base"
    }
    for part, bodies in names.items():
        for body in bodies:
            for actual, wanted in zip(of_model(gripper, body), expected[part], strict=True):
                np.testing.assert_allclose(actual, wanted, rtol=1e-9, atol=1e-12)


def test_the_gripper_weighs_what_was_published(gripper: mujoco.MjModel, figures: dict[str, Any]) -> None:
    assert gripper.body_mass.sum() == pytest.approx(figures["total_mass"], abs=1e-12)


def test_pivots_and_pads_of_the_open_gripper_are_where_they_were_published(
    gripper: mujoco.MjModel, published: Bodies, figures: dict[str, Any]
) -> None:
    data = mujoco.MjData(gripper)
    set_angle(gripper, data, 0.0)
    on_base = np.array([0.0, 0.0, 0.0108])
    for body, source in (("left_driver", "right_driver"), ("left_knuckle", "right_spring_link")):
        np.testing.assert_allclose(data.body(body).xpos, on_base + published[source]["position"], atol=1e-12)
    finger = on_base + published["right_spring_link"]["position"] + published["right_follower"]["position"]
    np.testing.assert_allclose(data.body("left_finger").xpos, finger, atol=2e-7)
    # The table's gripper is turned by -pi/2 about z, so its left pad is at -x; it opens by 0.2 mm less to each side.
    height = figures["open_pad"][2] + gripper.geom("left_pad").size[2]
    assert data.geom("left_pad").xpos[2] == pytest.approx(height, abs=2e-5)


def test_meshes_of_the_collection_sit_on_the_parts_they_belong_to(gripper: mujoco.MjModel, published: Bodies) -> None:
    assert ROBOTIQ_2F85.menagerie is not None
    data = mujoco.MjData(gripper)
    set_angle(gripper, data, 0.0)
    # The table's gripper is turned by -pi/2 about z.
    here = Pose((0.0, 0.0, 0.0), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    for body in ROBOTIQ_2F85.menagerie.bodies:
        name, pose = body.source, Pose()
        while name != "world":
            row = published[name]
            pose = Pose(row["position"], np.roll(row["quaternion_wxyz"], -1)) * pose
            name = row["parent"]
        part = data.body(body.body)
        mount = Pose(body.source_in_body.translation, body.source_in_body.quaternion)
        actual = Pose(part.xpos, np.roll(part.xquat, -1)) * mount
        np.testing.assert_allclose(actual.matrix, (here * pose).matrix, atol=1e-6)


def test_the_reduced_linkage_keeps_the_loop_of_the_published_one_closed(
    gripper: mujoco.MjModel, published: Bodies, figures: dict[str, Any]
) -> None:
    # Where the finger is pinned to the knuckle, both must stay together: driver and knuckle are not quite parallel.
    on_finger = np.array(figures["follower_pivot"])
    on_knuckle = np.array(published["right_follower"]["position"]) + on_finger
    data = mujoco.MjData(gripper)
    for angle in np.linspace(ROBOTIQ_2F85.joint_open[0], ROBOTIQ_2F85.joint_closed[0], 9):
        set_angle(gripper, data, angle)
        for side in ("left", "right"):
            finger, knuckle = data.body(f"{side}_finger"), data.body(f"{side}_knuckle")
            one = finger.xpos + finger.xmat.reshape(3, 3) @ on_finger
            other = knuckle.xpos + knuckle.xmat.reshape(3, 3) @ on_knuckle
            assert np.linalg.norm(one - other) < 7e-4


def test_the_pads_meet_in_the_middle_when_closed_and_are_a_width_apart_when_open(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    (left,), (right,) = ROBOTIQ_2F85.pad_geoms
    for q, width in ((ROBOTIQ_2F85.joint_closed, 0.0), (ROBOTIQ_2F85.joint_open, ROBOTIQ_2F85.max_width)):
        set_angle(gripper, data, q[0])
        assert pad_gap(gripper, data) == pytest.approx(width, abs=1e-7)
        np.testing.assert_allclose(data.geom(left).xpos, data.geom(right).xpos * [1, -1, 1], atol=1e-12)
        assert data.ncon == 0


def test_the_pads_stay_parallel_and_the_width_is_nearly_linear_in_the_angle(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    closed = ROBOTIQ_2F85.joint_closed[0]
    for opening in np.linspace(0.0, 1.0, 11):
        set_angle(gripper, data, (1.0 - opening) * closed)
        np.testing.assert_allclose(data.geom("left_pad").xmat.reshape(3, 3), np.eye(3), atol=1e-12)
        assert 0.0 <= pad_gap(gripper, data) - opening * ROBOTIQ_2F85.max_width + 1e-7 < 3e-3


def test_the_tcp_is_the_centre_of_the_closed_pads(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    set_angle(gripper, data, ROBOTIQ_2F85.joint_closed[0])
    tcp = data.site(ROBOTIQ_2F85.tcp_site)
    np.testing.assert_array_equal(tcp.xpos, ROBOTIQ_2F85.tcp_in_base.translation)
    between = (data.geom("left_pad").xpos + data.geom("right_pad").xpos) / 2
    np.testing.assert_allclose(tcp.xpos, between, atol=1e-4)


def test_an_empty_gripper_closes_and_opens_within_a_second_at_its_closing_speed(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    stroke = ROBOTIQ_2F85.max_width / 2
    steps = round(stroke / ROBOTIQ_2F85.closing_speed / gripper.opt.timestep)
    assert steps * gripper.opt.timestep < 1.0
    for ctrl, width in ((ROBOTIQ_2F85.ctrl_closed, 0.0), (ROBOTIQ_2F85.ctrl_open, ROBOTIQ_2F85.max_width)):
        data.ctrl[0] = ctrl
        mujoco.mj_step(gripper, data, nstep=round(0.9 * steps))
        assert abs(pad_gap(gripper, data) - width) > 2e-3
        mujoco.mj_step(gripper, data, nstep=round(0.2 * steps) + 50)
        assert pad_gap(gripper, data) == pytest.approx(width, abs=3e-4)
        assert data.ncon == 0


def test_all_joints_turn_by_the_same_angle_while_the_gripper_moves(gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(gripper)
    for opening in (0.25, 0.9, 0.5):
        data.ctrl[0] = opening
        for _ in range(20):
            mujoco.mj_step(gripper, data, nstep=20)
            assert np.ptp(data.qpos) < 1e-3
        assert data.qpos.mean() == pytest.approx((1.0 - opening) * ROBOTIQ_2F85.joint_closed[0], abs=1e-4)
