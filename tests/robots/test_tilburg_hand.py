"""The Tilburg Hand model: published figures, joint order, poses; test_tilburg_hand_grasps.py lifts things."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.spatial import Pose
from tests.robots.published import pose_of, read_figures

Figures = dict[str, Any]
LOWER, UPPER = np.array(TILBURG_HAND.joint_lower), np.array(TILBURG_HAND.joint_upper)
every_grasp = pytest.mark.parametrize("grasp", sorted(TILBURG_HAND.grasps))


@pytest.fixture(scope="module")
def figures() -> Figures:
    return read_figures("tilburg_hand")


@pytest.fixture(scope="module")
def hand() -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(TILBURG_HAND.mjcf))
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


def bodies_from_chain(figures: Figures, q: dict[str, float]) -> dict[str, Pose]:
    """Pose of every body in the base frame, from the joint table."""
    poses = {"hand": Pose()}
    for link in figures["chain"]:
        turn = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, link["sign"] * q[link["joint"]]))
        poses[link["body"]] = poses[link["parent"]] * pose_of(link) * turn
    return poses


def joints(normalised: Iterable[float]) -> NDArray[np.float64]:
    """Joint positions [rad] of normalised ones, in the order of the description."""
    return LOWER + np.array(list(normalised)) * (UPPER - LOWER)


def at(model: mujoco.MjModel, q: NDArray[np.float64]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for joint, actuator, value in zip(TILBURG_HAND.joints, TILBURG_HAND.actuators, q, strict=True):
        data.joint(joint).qpos[0] = data.actuator(actuator).ctrl[0] = value
    mujoco.mj_forward(model, data)
    return data


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[frozenset[str]]:
    """Pairs of bodies in contact."""
    return {frozenset(model.body(model.geom_bodyid[geom]).name for geom in pair) for pair in data.contact.geom}


def close(model: mujoco.MjModel, grasp: str) -> mujoco.MjData:
    """Close an empty hand within half a second and wait for another second and a half."""
    start, goal = joints(TILBURG_HAND.open_pose), joints(TILBURG_HAND.grasps[grasp])
    data = at(model, start)
    for step in range(1000):
        data.ctrl[:] = start + (goal - start) * min(1.0, step / 250)
        mujoco.mj_step(model, data)
    return data


def test_the_ring_fingers_tip_is_where_it_was_published(hand: mujoco.MjModel, figures: Figures) -> None:
    body = at(hand, np.zeros(16)).body("ring_distal")
    np.testing.assert_allclose(body.xpos, figures["published_ring_distal"]["position"], atol=1e-12)
    np.testing.assert_allclose(body.xmat, figures["published_ring_distal"]["rotation"], atol=1e-12)


def test_all_bodies_follow_the_joint_table(hand: mujoco.MjModel, figures: Figures) -> None:
    rng = np.random.default_rng(1)
    for q in [joints(TILBURG_HAND.open_pose), *rng.uniform(LOWER, UPPER, (20, 16))]:
        data = at(hand, q)
        poses = bodies_from_chain(figures, dict(zip(TILBURG_HAND.joints, q, strict=True)))
        for name, pose in poses.items():
            np.testing.assert_allclose(data.body(name).xpos, pose.translation, atol=1e-9)
            np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), pose.matrix[:3, :3], atol=1e-9)


def test_masses_and_inertias_equal_the_table(
    hand: mujoco.MjModel, figures: Figures, inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]]
) -> None:
    for link in figures["links"]:
        body = hand.body(link["link"])
        assert body.mass[0] == link["mass"]
        np.testing.assert_allclose(body.ipos, link["com"], atol=1e-15)
        np.testing.assert_allclose(inertia_in_body(hand, link["link"]), link["inertia_xx_yy_zz_xy_xz_yz"], atol=1e-12)
    assert hand.body_mass.sum() == pytest.approx(0.634, abs=1e-3)


def test_joints_have_the_drivers_order_and_ranges(hand: mujoco.MjModel, figures: Figures) -> None:
    assert TILBURG_HAND.joints == tuple(row["joint"] for row in figures["driver"])
    for i, row in enumerate(figures["driver"]):
        limits = np.radians(row["degrees"])
        np.testing.assert_array_equal([TILBURG_HAND.joint_lower[i], TILBURG_HAND.joint_upper[i]], limits)
        np.testing.assert_allclose(hand.joint(row["joint"]).range, limits, atol=1e-15)
        np.testing.assert_allclose(hand.actuator(i).ctrlrange, limits, atol=1e-15)
        assert hand.actuator(i).name == TILBURG_HAND.actuators[i]
        assert int(hand.actuator(i).trnid[0]) == hand.joint(row["joint"]).id


def test_joint_dynamics_equal_the_table(hand: mujoco.MjModel, figures: Figures) -> None:
    np.testing.assert_array_equal(hand.jnt_actfrcrange, [[-figures["torque"], figures["torque"]]] * 16)
    np.testing.assert_array_equal(hand.dof_armature, figures["armature"])
    np.testing.assert_array_equal(hand.dof_frictionloss, figures["frictionloss"])
    # At the published speed the damping takes up the whole torque.
    np.testing.assert_allclose(hand.dof_damping * figures["speed"], figures["torque"])


def test_the_fingers_bend_towards_where_the_palm_faces(hand: mujoco.MjModel) -> None:
    flat = at(hand, np.zeros(16))
    for finger in ("index", "middle", "ring"):
        bent = at(hand, np.array([0.8 * name.startswith(f"{finger}_mcp") for name in TILBURG_HAND.joints]))
        assert bent.body(f"{finger}_distal").xpos[2] > flat.body(f"{finger}_distal").xpos[2] + 0.05


def test_the_mount_points_the_fingers_along_the_flanges_x_axis_and_the_tcp_has_the_flanges_axes() -> None:
    mount, tcp = (one.pose.matrix[:3, :3] for one in (TILBURG_HAND.mount_in_flange, TILBURG_HAND.tcp_in_base))
    np.testing.assert_allclose(mount @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(mount @ tcp, np.eye(3), atol=1e-15)


def test_site_and_description_agree_on_the_tcp(hand: mujoco.MjModel) -> None:
    site = hand.site(TILBURG_HAND.tcp_site)
    np.testing.assert_array_equal(site.pos, TILBURG_HAND.tcp_in_base.translation)
    np.testing.assert_allclose(np.roll(site.quat, -1), TILBURG_HAND.tcp_in_base.quaternion, atol=1e-15)


def test_finger_geoms_are_the_capsules_that_grasp(hand: mujoco.MjModel) -> None:
    named = [name for names in TILBURG_HAND.finger_geoms.values() for name in names]
    for name in named:
        assert hand.geom(name).type == mujoco.mjtGeom.mjGEOM_CAPSULE
        assert hand.geom(name).condim == 4
        assert hand.geom(name).contype == 1
    graspers = {hand.geom(i).name for i in range(hand.ngeom) if hand.geom_condim[i] == 4}
    assert graspers == {*named, "palm"}


def test_the_open_hand_touches_nothing_and_a_toy_of_8_cm_fits_between_its_fingers(hand: mujoco.MjModel) -> None:
    data = at(hand, joints(TILBURG_HAND.open_pose))
    assert data.ncon == 0
    tcp = data.site(TILBURG_HAND.tcp_site).xpos
    for geom in (name for names in TILBURG_HAND.finger_geoms.values() for name in names):
        axis = data.geom(geom).xmat.reshape(3, 3)[:, 2]
        radius, half = hand.geom(geom).size[:2]
        for along in np.linspace(-half, half, 9):
            point = data.geom(geom).xpos + along * axis
            # Above this the toy ends: its centre is at the TCP.
            if point[2] > tcp[2] - 0.04:
                assert np.hypot(*(point - tcp)[:2]) - radius > 0.045


@every_grasp
def test_an_empty_hand_closes_stably(hand: mujoco.MjModel, grasp: str) -> None:
    data = close(hand, grasp)
    assert np.abs(data.qvel).max() < 0.1
    assert np.all(data.qpos >= hand.jnt_range[:, 0] - 0.02)
    assert np.all(data.qpos <= hand.jnt_range[:, 1] + 0.02)


@pytest.mark.parametrize(("grasp", "met"), [("precision", {"index"}), ("tripod", {"index", "middle"})])
def test_the_thumb_meets_the_tips_of_the_fingers_that_pinch(hand: mujoco.MjModel, grasp: str, met: set[str]) -> None:
    pairs = touching(hand, close(hand, grasp))
    assert pairs == {frozenset(("thumb_distal", f"{finger}_distal")) for finger in met}


def test_in_a_lateral_grasp_the_thumb_presses_on_the_side_of_the_index_finger(hand: mujoco.MjModel) -> None:
    data = close(hand, "lateral")
    assert touching(hand, data) == {frozenset(("thumb_distal", "index_middle"))}
    # Across the fingers, not along them and not towards the palm.
    assert abs(data.contact.frame[0, 0]) > 0.9


def test_a_hand_told_to_fold_everything_at_once_stays_finite_and_calm(hand: mujoco.MjModel) -> None:
    data = at(hand, joints(TILBURG_HAND.open_pose))
    data.ctrl[:] = UPPER
    mujoco.mj_step(hand, data, nstep=1500)
    assert np.all(np.isfinite(data.qpos))
    assert np.abs(data.qvel).max() < 0.2
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0


def test_a_free_finger_follows_a_target_without_overshoot(hand: mujoco.MjModel) -> None:
    data = at(hand, joints(TILBURG_HAND.open_pose))
    data.actuator("middle_mcp").ctrl[0] = 1.2
    reached = []
    for _ in range(1000):
        mujoco.mj_step(hand, data)
        reached.append(data.joint("middle_mcp").qpos[0])
    # Dry friction leaves less than frictionloss / kp = 2 mrad.
    assert reached[-1] == pytest.approx(1.2, abs=2e-3)
    assert max(reached) < 1.2 + 2e-3
