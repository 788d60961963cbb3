from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import DampedLeastSquares, kinematics_of
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import Pose


def test_forward_kinematics_are_those_of_mujoco(
    model: mujoco.MjModel, solver: DampedLeastSquares, random_joints: NDArray[np.float64]
) -> None:
    data = mujoco.MjData(model)
    for joints in random_joints:
        data.qpos[:7] = joints
        mujoco.mj_kinematics(model, data)
        site = data.site("gripper/" + FRANKA_HAND.tcp_site)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        assert solver.forward(joints).is_close(Pose.from_matrix(matrix), 1e-12, 1e-7)


WINDING = """
<mujoco><worldbody><body name="stand" pos=".3 .1 .2" euler="10 20 30"><geom size=".1"/>
<body pos="0 .1 .3" euler="30 0 0"><joint name="a" axis="1 2 3" pos=".1 0 .05" ref="20"/><geom size=".1"/>
<joint name="b" type="slide" axis="0 1 1" ref=".2"/>
<body pos="0 0 .2"><geom size=".1"/><body pos=".1 0 .1" euler="0 40 0"><joint name="still" ref="50"/><geom size=".1"/>
<joint name="c" axis="0 1 0" pos="0 .2 0"/>
<site name="tcp" pos=".1 .2 .3" euler="5 6 7"/></body></body></body></body>
<body name="beside"><geom size=".1"/></body></worldbody></mujoco>
"""
"""Joints off the bodies' origins, slides, several to a body, zeros elsewhere, a base that is turned."""


def test_any_chain_of_hinges_and_slides_moves_as_in_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(WINDING)
    data = mujoco.MjData(model)
    names = ["a", "b", "c"]
    solver = DampedLeastSquares(model, [model.joint(name).id for name in names], 0, model.body("stand").id)
    for joints in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3)):
        for name, value in zip(names, joints, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_forward(model, data)
        pose, site, base = np.eye(4), data.site("tcp"), data.body("stand")
        pose[:3, :3] = base.xmat.reshape(3, 3).T @ site.xmat.reshape(3, 3)
        pose[:3, 3] = base.xmat.reshape(3, 3).T @ (site.xpos - base.xpos)
        assert solver.forward(joints).is_close(Pose.from_matrix(pose), 1e-12, 1e-7)
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], 0)
        turned = np.concatenate([base.xmat.reshape(3, 3).T @ part for part in (jacobian[:3], jacobian[3:])])
        dofs = [model.joint(name).dofadr[0] for name in names]
        np.testing.assert_allclose(solver.jacobian(joints), turned[:, dofs], atol=1e-12)


def test_the_base_must_carry_the_tcp() -> None:
    model = mujoco.MjModel.from_xml_string(WINDING)
    with pytest.raises(InvalidSetup, match="does not carry the TCP"):
        DampedLeastSquares(model, [0], 0, model.body("beside").id)


def test_without_a_gripper_the_pose_is_that_of_the_flange(solver: DampedLeastSquares) -> None:
    flange = kinematics_of(FR3).forward(np.array(FR3.home))
    tcp = solver.forward(np.array(FR3.home))
    mount, end = FRANKA_HAND.mount_in_flange, FRANKA_HAND.tcp_in_base
    expected = flange * Pose(mount.translation, mount.quaternion) * Pose(end.translation, end.quaternion)
    assert tcp.is_close(expected, 1e-9, 1e-7)


def test_the_jacobian_is_the_derivative_of_the_pose(
    solver: DampedLeastSquares, random_joints: NDArray[np.float64]
) -> None:
    step = 1e-6
    for joints in random_joints[:20]:
        jacobian = solver.jacobian(joints)
        assert jacobian.shape == (6, 7)
        numeric = np.empty((6, 7))
        for i in range(7):
            moved = [joints + sign * step * np.eye(7)[i] for sign in (1, -1)]
            after, before = (solver.forward(q) for q in moved)
            numeric[:3, i] = (np.array(after.translation) - np.array(before.translation)) / (2 * step)
            turn = np.array((after * before.inverse()).quaternion)
            numeric[3:, i] = 2 * turn[:3] * np.sign(turn[3]) / (2 * step)
        np.testing.assert_allclose(jacobian, numeric, atol=1e-6)


def test_a_batch_of_poses_is_a_loop_over_poses(solver: DampedLeastSquares, random_joints: NDArray[np.float64]) -> None:
    batch = solver.forward_batch(random_joints)
    np.testing.assert_array_equal(batch, [solver.forward(joints).tquat for joints in random_joints])


@pytest.mark.parametrize("bad", [np.zeros(6), np.zeros(8), np.zeros(0), np.full(7, np.nan), np.full(7, np.inf)])
def test_joints_of_a_wrong_number_or_not_finite_are_refused(
    solver: DampedLeastSquares, bad: NDArray[np.float64]
) -> None:
    for call in (solver.forward, solver.jacobian):
        with pytest.raises(InvalidSetup):
            call(bad)
    with pytest.raises(InvalidSetup):
        solver.forward_batch(bad[None])


def test_ids_that_are_not_in_the_model_are_refused(model: mujoco.MjModel) -> None:
    joints = list(range(7))
    for arguments in (([], 0, 0), ([99], 0, 0), (joints, 99, 0), (joints, 0, 99), (joints, -1, 0)):
        with pytest.raises(InvalidSetup, match="inverse kinematics"):
            DampedLeastSquares(model, *arguments)
