"""The SO101 model, arm and gripper together, against the published figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.kinematics import attach_end_effector, load
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.spatial import Pose
from rcs.testing import DescriptionContract
from tests.robots.published import pose_of, read_figures

Figures = dict[str, Any]

FOLDED = (0.0, -1.7, 1.4, 1.2, 0.0)
"""Near the pose in which people park it: it must be free of contacts."""


class TestTheDescription(DescriptionContract):
    """The arm with its gripper."""

    arm = SO101
    gripper = SO101_GRIPPER
    hold_tolerance = 1e-6
    settle_time = 0.5

    def published_chain(self) -> tuple[str, list[Pose]]:
        """Return the table of bodies with the gripper frame."""
        figures = read_figures("so101")
        return "gripper/gripperframe", [*map(pose_of, [*figures["bodies"][1:6], figures["gripperframe"]])]


@pytest.fixture(scope="module")
def figures() -> Figures:
    return read_figures("so101")


@pytest.fixture(scope="module")
def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(SO101.mjcf))


@pytest.fixture(scope="module")
def with_gripper() -> mujoco.MjModel:
    spec = load(SO101)
    attach_end_effector(spec, SO101, SO101_GRIPPER)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


def set_joints(model: mujoco.MjModel, data: mujoco.MjData, q: NDArray[np.float64]) -> None:
    for joint, value in zip(SO101.joints, q, strict=True):
        data.joint(joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for joint, actuator, q in zip(SO101.joints, SO101.actuators, SO101.home, strict=True):
        data.joint(joint).qpos[0] = q
        data.actuator(actuator).ctrl[0] = q
    data.joint("gripper/gripper").qpos[0] = SO101_GRIPPER.joint_open[0]
    data.actuator("gripper/gripper").ctrl[0] = SO101_GRIPPER.ctrl_open
    mujoco.mj_forward(model, data)
    return data


def test_at_zero_the_gripper_frame_is_where_it_was_published(with_gripper: mujoco.MjModel, figures: Figures) -> None:
    data = mujoco.MjData(with_gripper)
    mujoco.mj_forward(with_gripper, data)
    frame = data.site("gripper/gripperframe")
    published = figures["published_gripperframe_qpos0"]
    np.testing.assert_allclose([*frame.xpos, *frame.xmat], published, atol=1e-12)


def test_the_tcp_is_the_published_gripper_frame_with_other_axes(with_gripper: mujoco.MjModel) -> None:
    data = at_home(with_gripper)
    frame, tcp = data.site("gripper/gripperframe"), data.site("gripper/tcp")
    np.testing.assert_allclose(tcp.xpos, frame.xpos, atol=1e-12)
    # Its z axis is the published frame's x axis, its y axis that one's z axis.
    np.testing.assert_allclose(tcp.xmat.reshape(3, 3), frame.xmat.reshape(3, 3)[:, [1, 2, 0]], atol=1e-9)


def test_the_flange_points_where_the_jaws_do(with_gripper: mujoco.MjModel) -> None:
    data = at_home(with_gripper)
    flange, tcp = data.site(SO101.flange_site), data.site("gripper/tcp")
    np.testing.assert_allclose(flange.xmat[2::3], tcp.xmat[2::3], atol=1e-12)


def test_masses_and_inertias_equal_the_table(
    arm: mujoco.MjModel, figures: Figures, inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]]
) -> None:
    for row in figures["bodies"][:5]:
        body = arm.body(row["body"])
        assert body.mass[0] == row["mass"]
        np.testing.assert_allclose(body.ipos, row["com"], atol=1e-15)
        np.testing.assert_allclose(inertia_in_body(arm, row["body"]), row["inertia"], atol=1e-12)


def test_horn_and_gripper_are_together_the_published_gripper_link(
    with_gripper: mujoco.MjModel, figures: Figures
) -> None:
    (row,) = [body for body in figures["bodies"] if body["body"] == "gripper"]
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    # The frames of both are the published link's.
    for name in ("roll_horn", "gripper/gripper"):
        body = with_gripper.body(name)
        turned = pose_of({"quat_wxyz": body.iquat}).matrix[:3, :3]
        offset = body.ipos
        mass += body.mass[0]
        moment += body.mass[0] * offset
        inertia += turned @ np.diag(body.inertia) @ turned.T
        inertia += body.mass[0] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    com = moment / mass
    inertia -= mass * (com @ com * np.eye(3) - np.outer(com, com))
    assert mass == pytest.approx(row["mass"], abs=1e-15)
    np.testing.assert_allclose(com, row["com"], atol=1e-12)
    np.testing.assert_allclose(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], row["inertia"], atol=1e-12)


def test_limits_and_joint_dynamics_equal_the_table(arm: mujoco.MjModel, figures: Figures) -> None:
    for i, row in enumerate(figures["joints"][:5]):
        assert row["joint"] == SO101.joints[i]
        joint, actuator = arm.joint(row["joint"]), arm.actuator(SO101.actuators[i])
        assert [SO101.joint_lower[i], SO101.joint_upper[i]] == row["range"] == list(joint.range)
        assert list(actuator.ctrlrange) == row["range"]
        assert SO101.effort_limit[i] == row["force"]
        np.testing.assert_array_equal(arm.jnt_actfrcrange[joint.id], [-row["force"], row["force"]])
        for name in ("armature", "damping", "frictionloss"):
            assert getattr(joint, name)[0] == row[name]


def test_servos_neither_swing_nor_saturate_on_the_way(arm: mujoco.MjModel) -> None:
    data = mujoco.MjData(arm)
    set_joints(arm, data, np.zeros(5))  # stretched out
    mujoco.mj_forward(arm, data)
    inertia = np.zeros((arm.nv, arm.nv))
    mujoco.mj_fullM(arm, data, inertia)
    for i, joint in enumerate(SO101.joints):
        dof, actuator = arm.joint(joint).dofadr[0], arm.actuator(SO101.actuators[i])
        stiffness, damping = actuator.gainprm[0], arm.dof_damping[dof] - actuator.biasprm[2]
        assert damping / (2 * np.sqrt(stiffness * inertia[dof, dof])) > 0.7
        needed = inertia[dof, dof] * SO101.acceleration_limit[i] + arm.dof_damping[dof] * SO101.velocity_limit[i]
        assert needed < SO101.effort_limit[i]


def test_at_home_the_gripper_is_above_the_table_tilted_by_thirty_degrees_and_nothing_touches(
    with_gripper: mujoco.MjModel,
) -> None:
    data = at_home(with_gripper)
    tcp = data.site("gripper/tcp")
    assert data.ncon == 0
    np.testing.assert_allclose(tcp.xpos, [0.25, 0.0, 0.147], atol=3e-3)
    assert np.degrees(np.arccos(-tcp.xmat[8])) == pytest.approx(30.0, abs=1e-6)


def test_the_arm_is_free_of_contacts_near_its_parking_pose(with_gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(with_gripper)
    set_joints(with_gripper, data, np.array(FOLDED))
    mujoco.mj_collision(with_gripper, data)
    assert data.ncon == 0


def test_links_that_overlap_by_construction_do_not_touch_while_the_elbow_is_not_folded(
    with_gripper: mujoco.MjModel,
) -> None:
    # At 0.9 rad the lower arm is 38 degrees from the upper arm; further, it meets the shoulder, as the real one does.
    rng = np.random.default_rng(3)
    data = mujoco.MjData(with_gripper)
    poses = rng.uniform(SO101.joint_lower, SO101.joint_upper, (500, SO101.dof))
    poses[:, 2] = np.minimum(poses[:, 2], 0.9)
    touching: dict[frozenset[str], int] = {}
    for q in poses:
        set_joints(with_gripper, data, q)
        mujoco.mj_collision(with_gripper, data)
        bodies = with_gripper.geom_bodyid[data.contact.geom]
        for pair in {frozenset(with_gripper.body(int(i)).name for i in row) for row in bodies}:
            touching[pair] = touching.get(pair, 0) + 1
    chain = ("base", "shoulder", "upper_arm", "lower_arm", "wrist", "gripper/gripper", "gripper/moving_jaw")
    for pair in zip(chain[:-2], chain[2:], strict=True):
        assert touching.get(frozenset(pair), 0) < len(poses) / 50
    assert max(touching.values(), default=0) < len(poses) / 5


def test_a_folded_arm_touches_itself(with_gripper: mujoco.MjModel) -> None:
    data = mujoco.MjData(with_gripper)
    set_joints(with_gripper, data, np.array([0.0, 0.0, 1.69, 0.0, 0.0]))
    mujoco.mj_collision(with_gripper, data)
    assert data.ncon > 0
