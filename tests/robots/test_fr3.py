"""The FR3 model against the published figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.fr3.description import FR3

Figures = dict[str, Any]


def rotation(rpy: list[float]) -> NDArray[np.float64]:
    """Rotation matrix of fixed-axis roll, pitch, yaw [rad]."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx


def flange_from_chain(fr3: Figures, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position and rotation of the flange in the base frame, from the vendor's joint table."""
    position, orientation = np.zeros(3), np.eye(3)
    for joint, angle in zip(fr3["chain"], q, strict=True):
        position = position + orientation @ joint["xyz"]
        orientation = orientation @ rotation(joint["rpy"]) @ rotation([0.0, 0.0, angle])
    return position + orientation @ fr3["flange_xyz"], orientation


def set_joints(model: mujoco.MjModel, data: mujoco.MjData, q: NDArray[np.float64], prefix: str = "") -> None:
    for joint, value in zip(FR3.joints, q, strict=True):
        data.joint(prefix + joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)


@pytest.mark.parametrize("pose", ["qpos0", "home"])
def test_the_flange_is_where_it_was_published(fr3: mujoco.MjModel, figures: Figures, pose: str) -> None:
    published = figures["fr3"]["published_flange"][pose]
    data = mujoco.MjData(fr3)
    set_joints(fr3, data, np.array(published["q"]))
    flange = data.site(FR3.flange_site)
    np.testing.assert_allclose(flange.xpos, published["position"], atol=1e-12)
    np.testing.assert_allclose(flange.xmat, published["rotation"], atol=1e-12)


def test_the_flange_follows_the_vendors_joint_table(fr3: mujoco.MjModel, figures: Figures) -> None:
    rng = np.random.default_rng(1)
    data = mujoco.MjData(fr3)
    for q in [np.array(FR3.home), *rng.uniform(FR3.joint_lower, FR3.joint_upper, (20, FR3.dof))]:
        set_joints(fr3, data, q)
        position, orientation = flange_from_chain(figures["fr3"], q)
        flange = data.site(FR3.flange_site)
        np.testing.assert_allclose(flange.xpos, position, atol=1e-9)
        np.testing.assert_allclose(flange.xmat.reshape(3, 3), orientation, atol=1e-9)


def test_the_tcp_follows_flange_mount_and_hand(lab: mujoco.MjModel, figures: Figures) -> None:
    rng = np.random.default_rng(2)
    data = mujoco.MjData(lab)
    mount = rotation(figures["franka_hand"]["mount_rpy"])
    for q in [np.array(FR3.home), *rng.uniform(FR3.joint_lower, FR3.joint_upper, (20, FR3.dof))]:
        set_joints(lab, data, q, prefix="arm/")
        position, orientation = flange_from_chain(figures["fr3"], q)
        orientation = orientation @ mount
        tcp = data.site("hand/tcp")
        np.testing.assert_allclose(tcp.xpos, position + orientation @ figures["franka_hand"]["tcp_xyz"], atol=1e-9)
        np.testing.assert_allclose(tcp.xmat.reshape(3, 3), orientation, atol=1e-9)


def test_masses_and_inertias_equal_the_table(
    fr3: mujoco.MjModel, figures: Figures, inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]]
) -> None:
    for link in figures["fr3"]["links"]:
        body = fr3.body(link["link"])
        assert body.mass[0] == link["mass"]
        np.testing.assert_array_equal(body.ipos, link["com"])
        np.testing.assert_allclose(inertia_in_body(fr3, link["link"]), link["inertia_xx_yy_zz_xy_xz_yz"], atol=1e-12)


def test_limits_and_joint_dynamics_equal_the_table_in_model_and_description(
    fr3: mujoco.MjModel, figures: Figures
) -> None:
    for i, row in enumerate(figures["fr3"]["limits"]):
        joint = fr3.joint(FR3.joints[i])
        assert [FR3.joint_lower[i], FR3.joint_upper[i]] == row["range"] == list(joint.range)
        assert FR3.effort_limit[i] == row["effort"]
        np.testing.assert_array_equal(fr3.jnt_actfrcrange[joint.id], [-row["effort"], row["effort"]])
        assert FR3.velocity_limit[i] == row["velocity"]
        assert [joint.armature[0], joint.damping[0], joint.frictionloss[0]] == [
            row["armature"],
            row["damping"],
            row["frictionloss"],
        ]


def test_servo_gains_equal_the_table(fr3: mujoco.MjModel, figures: Figures) -> None:
    for name, row in zip(FR3.actuators, figures["fr3"]["limits"], strict=True):
        actuator = fr3.actuator(name)
        assert actuator.gainprm[0] == row["kp"]
        np.testing.assert_array_equal(actuator.biasprm[:3], [0.0, -row["kp"], -row["kv"]])
        np.testing.assert_array_equal(actuator.ctrlrange, row["range"])


def test_joints_and_actuators_are_numbered_from_base_to_tip(fr3: mujoco.MjModel) -> None:
    assert [fr3.joint(name).id for name in FR3.joints] == list(range(FR3.dof))
    assert [int(fr3.actuator(name).trnid[0]) for name in FR3.actuators] == list(range(FR3.dof))


def test_at_home_the_tcp_points_down_and_nothing_touches(
    lab: mujoco.MjModel, at_home: Callable[[mujoco.MjModel], mujoco.MjData]
) -> None:
    data = at_home(lab)
    assert data.ncon == 0
    np.testing.assert_allclose(data.site("hand/tcp").xmat.reshape(3, 3), np.diag([1.0, -1.0, -1.0]), atol=1e-9)


def test_no_pair_of_links_touches_in_more_than_a_fiftieth_of_all_poses(lab: mujoco.MjModel) -> None:
    # A pair whose shapes overlap by construction would touch in every pose, or in every pose of one joint.
    rng = np.random.default_rng(3)
    data = mujoco.MjData(lab)
    poses = rng.uniform(FR3.joint_lower, FR3.joint_upper, (500, FR3.dof))
    touching: dict[tuple[int, int], int] = {}
    for q in poses:
        set_joints(lab, data, q, prefix="arm/")
        mujoco.mj_collision(lab, data)
        bodies = lab.geom_bodyid[data.contact.geom]
        for pair in {(int(a), int(b)) for a, b in bodies}:
            touching[pair] = touching.get(pair, 0) + 1
    assert max(touching.values()) < len(poses) / 50


def test_a_folded_arm_touches_itself(lab: mujoco.MjModel) -> None:
    data = mujoco.MjData(lab)
    set_joints(lab, data, np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.6, 0.0]), prefix="arm/")
    mujoco.mj_collision(lab, data)
    assert data.ncon > 0


def test_the_arm_rests_on_the_floor_without_touching_it() -> None:
    spec = mujoco.MjSpec.from_file(str(FR3.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    model = spec.compile()
    data = mujoco.MjData(model)
    set_joints(model, data, np.array(FR3.home))
    mujoco.mj_collision(model, data)
    assert data.ncon == 0


def test_the_servos_hold_the_home_pose_without_sagging(
    lab: mujoco.MjModel, at_home: Callable[[mujoco.MjModel], mujoco.MjData]
) -> None:
    data = at_home(lab)
    mujoco.mj_step(lab, data, nstep=500)
    q = [data.joint(f"arm/{joint}").qpos[0] for joint in FR3.joints]
    np.testing.assert_allclose(q, FR3.home, atol=1e-9)


def test_no_command_asks_more_torque_of_a_joint_than_its_limit(
    lab: mujoco.MjModel, at_home: Callable[[mujoco.MjModel], mujoco.MjData]
) -> None:
    data = at_home(lab)
    dofs = [int(lab.joint(f"arm/{joint}").dofadr[0]) for joint in FR3.joints]
    for name, upper in zip(FR3.actuators, FR3.joint_upper, strict=True):
        data.actuator(f"arm/{name}").ctrl[0] = upper
    for _ in range(100):
        mujoco.mj_step(lab, data)
        assert np.all(np.abs(data.qfrc_actuator[dofs]) <= np.array(FR3.effort_limit) + 1e-9)


def test_a_step_of_a_tenth_of_a_radian_settles_within_a_second(
    lab: mujoco.MjModel, at_home: Callable[[mujoco.MjModel], mujoco.MjData]
) -> None:
    data = at_home(lab)
    target = np.array(FR3.home) + 0.1
    for name, q in zip(FR3.actuators, target, strict=True):
        data.actuator(f"arm/{name}").ctrl[0] = q
    mujoco.mj_step(lab, data, nstep=500)
    reached = [data.joint(f"arm/{joint}").qpos[0] for joint in FR3.joints]
    # Dry friction leaves less than frictionloss / kp = 0.4 mrad.
    np.testing.assert_allclose(reached, target, atol=1e-3)
