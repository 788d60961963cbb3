from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import DampedLeastSquares, kinematics_of
from rcs.robots.fr3.description import FR3
from rcs.robots.franka_hand.description import FRANKA_HAND
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
