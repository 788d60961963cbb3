"""The UR5e model against the published figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.kinematics import attach_end_effector, load
from rcs.robots.robotiq_2f85 import ROBOTIQ_2F85
from rcs.robots.ur5e import UR5E
from rcs.setups.labs import UR5E as LAB
from rcs.spatial import Pose
from rcs.testing import DescriptionContract
from tests.robots.published import pose_of, read_figures

Figures = dict[str, Any]

WITHIN_REACH_OF_EACH_OTHER = (
    ("base", "upper_arm_link"),
    ("shoulder_link", "forearm_link"),
    ("upper_arm_link", "wrist_1_link"),
    ("forearm_link", "wrist_2_link"),
    ("wrist_1_link", "wrist_3_link"),
    ("wrist_2_link", "gripper/base"),
)
"""Links with one link between them: what overlaps by construction would be among these."""


class TestTheDescription(DescriptionContract):
    """The arm with a gripper."""

    arm = UR5E
    gripper = ROBOTIQ_2F85
    base_in_scene = LAB.stands[0].base_in_scene
    hold_tolerance = 1e-6
    settle_time = 2.0  # the published gains are slow: kv / kp is 0.2 s

    def published_chain(self) -> tuple[str, list[Pose]]:
        """Return the vendor's joint table, whose last frame is the flange."""
        return UR5E.flange_site, [*map(pose_of, read_figures("ur5e")["chain"]), Pose()]


@pytest.fixture(scope="module")
def figures() -> Figures:
    return read_figures("ur5e")


@pytest.fixture(scope="module")
def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(UR5E.mjcf))


@pytest.fixture(scope="module")
def with_gripper() -> mujoco.MjModel:
    spec = load(UR5E)
    attach_end_effector(spec, UR5E, ROBOTIQ_2F85)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


def set_joints(model: mujoco.MjModel, data: mujoco.MjData, q: NDArray[np.float64]) -> None:
    for joint, value in zip(UR5E.joints, q, strict=True):
        data.joint(joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for joint, actuator, q in zip(UR5E.joints, UR5E.actuators, UR5E.home, strict=True):
        data.joint(joint).qpos[0] = q
        data.actuator(actuator).ctrl[0] = q
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("pose", ["qpos0", "home"])
def test_the_flange_is_where_others_published_it_within_their_rounding(
    arm: mujoco.MjModel, figures: Figures, pose: str
) -> None:
    published = figures["published_tool"][pose]
    data = mujoco.MjData(arm)
    set_joints(arm, data, np.array(published["q"]))
    flange = data.site(UR5E.flange_site)
    # They round the link lengths to a millimetre.
    np.testing.assert_allclose(flange.xpos, published["position"], atol=1.2e-3)
    np.testing.assert_allclose(flange.xmat, published["rotation"], atol=1e-8)


def test_masses_and_inertias_equal_the_vendors_table(
    arm: mujoco.MjModel, figures: Figures, inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]]
) -> None:
    for link in figures["links"]:
        body = arm.body(link["link"])
        assert body.mass[0] == link["mass"]
        np.testing.assert_allclose(body.ipos, link["com"], atol=1e-15)
        turned = Pose.from_rpy((0.0, 0.0, 0.0), link["inertia_rpy"]).matrix[:3, :3]
        inertia = turned @ np.diag(link["inertia_xx_yy_zz"]) @ turned.T
        expected = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        np.testing.assert_allclose(inertia_in_body(arm, link["link"]), expected, atol=1e-12)


def test_limits_equal_the_vendors_table_in_model_and_description(arm: mujoco.MjModel, figures: Figures) -> None:
    for i, row in enumerate(figures["chain"]):
        assert row["joint"] == UR5E.joints[i]
        joint = arm.joint(UR5E.joints[i])
        np.testing.assert_allclose([UR5E.joint_lower[i], UR5E.joint_upper[i]], row["range"], atol=1e-8)
        np.testing.assert_array_equal(joint.range, [UR5E.joint_lower[i], UR5E.joint_upper[i]])
        assert UR5E.velocity_limit[i] == pytest.approx(row["velocity"], abs=1e-8)
        assert UR5E.effort_limit[i] == row["effort"]
        np.testing.assert_array_equal(arm.jnt_actfrcrange[joint.id], [-row["effort"], row["effort"]])


def test_joint_dynamics_and_servo_gains_equal_the_table(arm: mujoco.MjModel, figures: Figures) -> None:
    for i, row in enumerate(figures["servos"]):
        assert (row["joint"], row["actuator"]) == (UR5E.joints[i], UR5E.actuators[i])
        joint, actuator = arm.joint(row["joint"]), arm.actuator(row["actuator"])
        for name in ("armature", "damping", "frictionloss"):
            assert getattr(joint, name)[0] == row[name]
        assert actuator.gainprm[0] == row["kp"]
        np.testing.assert_array_equal(actuator.biasprm[:3], [0.0, -row["kp"], -row["kv"]])
        np.testing.assert_array_equal(actuator.ctrlrange, joint.range)


def test_at_home_the_tcp_points_down_and_nothing_touches(with_gripper: mujoco.MjModel) -> None:
    data = at_home(with_gripper)
    assert data.ncon == 0
    np.testing.assert_allclose(data.site("gripper/tcp").xmat.reshape(3, 3), np.diag([1.0, -1.0, -1.0]), atol=1e-9)


def test_links_that_overlap_by_construction_do_not_touch_while_the_elbow_is_not_folded(
    with_gripper: mujoco.MjModel,
) -> None:
    # Folded further, forearm and upper arm of the real arm meet as well.
    rng = np.random.default_rng(3)
    data = mujoco.MjData(with_gripper)
    poses = rng.uniform(UR5E.joint_lower, UR5E.joint_upper, (500, UR5E.dof))
    poses[:, 2] *= 2.2 / np.pi
    touching: dict[frozenset[str], int] = {}
    for q in poses:
        set_joints(with_gripper, data, q)
        mujoco.mj_collision(with_gripper, data)
        bodies = with_gripper.geom_bodyid[data.contact.geom]
        for pair in {frozenset(with_gripper.body(int(i)).name for i in row) for row in bodies}:
            touching[pair] = touching.get(pair, 0) + 1
    for pair in WITHIN_REACH_OF_EACH_OTHER:
        assert touching.get(frozenset(pair), 0) < len(poses) / 50
    assert max(touching.values(), default=0) < len(poses) / 5


def test_a_folded_arm_touches_itself(arm: mujoco.MjModel) -> None:
    data = mujoco.MjData(arm)
    set_joints(arm, data, np.array([0.0, -1.5, 3.0, 0.0, 0.0, 0.0]))
    mujoco.mj_collision(arm, data)
    assert data.ncon > 0


def test_the_arm_stands_on_a_floor_without_touching_it() -> None:
    spec = mujoco.MjSpec.from_file(str(UR5E.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    assert at_home(spec.compile()).ncon == 0


def test_meshes_of_the_collection_sit_on_the_links_they_belong_to(arm: mujoco.MjModel, figures: Figures) -> None:
    assert UR5E.menagerie is not None
    mounts = {body.source: body for body in UR5E.menagerie.bodies}
    data = mujoco.MjData(arm)
    q = np.random.default_rng(5).uniform(-1.0, 1.0, UR5E.dof)
    set_joints(arm, data, q)
    position, orientation = np.zeros(3), np.eye(3)
    for row, angle in zip(figures["collection"], [0.0, *q], strict=True):
        position = position + orientation @ row["position"]
        orientation = orientation @ matrix_of(row["quaternion_wxyz"])
        if row["axis"] is not None:
            turn = np.empty(4)
            mujoco.mju_axisAngle2Quat(turn, np.array(row["axis"]), angle)
            orientation = orientation @ matrix_of(turn)
        mount, body = mounts[row["body"]].source_in_body, data.body(mounts[row["body"]].body)
        x, y, z, w = mount.quaternion
        turned = body.xmat.reshape(3, 3)
        np.testing.assert_allclose(turned @ matrix_of([w, x, y, z]), orientation, atol=1e-8)
        # Its link lengths are rounded to a millimetre.
        np.testing.assert_allclose(body.xpos + turned @ mount.translation, position, atol=2e-3)


def matrix_of(wxyz: list[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.array(wxyz) / np.linalg.norm(wxyz))
    return matrix.reshape(3, 3)
