"""Pinocchio and the built-in solver are two opinions on the same chain."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.devices import lookup
from rcs.errors import InvalidSetup, MissingDependency
from rcs.kinematics import (
    DampedLeastSquares,
    IkOptions,
    Kinematics,
    PinocchioKinematics,
    freedom_of,
    kinematics_of,
)
from rcs.spatial import Pose, distance

extras = pytest.mark.extras
ARMS = {"fr3": "franka_hand", "ur5e": "robotiq_2f85", "xarm7": "tilburg_hand", "so101": "so101_gripper"}
Pair = tuple[Any, Kinematics, Kinematics]


@pytest.fixture(scope="module", params=ARMS)
def pair(request: Any) -> Pair:
    """Return an arm's description, its built-in solver and Pinocchio's."""
    arm: Any = lookup.find("arm", request.param)
    kind = "hand" if ARMS[request.param] == "tilburg_hand" else "gripper"
    effector: Any = lookup.find(kind, ARMS[request.param])
    return arm, kinematics_of(arm, effector), kinematics_of(arm, effector, backend="pinocchio")


def random_of(kinematics: Kinematics, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(kinematics.joint_lower, kinematics.joint_upper, (count, kinematics.dof))


@extras
def test_both_know_the_same_pose_and_limits(pair: Pair) -> None:
    _, own, other = pair
    assert own.dof == other.dof
    np.testing.assert_array_equal(own.joint_lower, other.joint_lower)
    np.testing.assert_array_equal(own.joint_upper, other.joint_upper)
    joints = random_of(own, 200)
    assert distance(own.forward_batch(joints), other.forward_batch(joints)).max() < 1e-9


@extras
def test_both_have_the_same_jacobian_and_it_is_the_derivative_of_the_pose(pair: Pair) -> None:
    _, own, other = pair
    step = 1e-6
    for joints in random_of(own, 50):
        jacobian = other.jacobian(joints)
        np.testing.assert_allclose(jacobian, own.jacobian(joints), atol=1e-9)
        for c in range(own.dof):
            change = np.eye(own.dof)[c] * step
            after, before = other.forward(joints + change), other.forward(joints - change)
            turn = Pose([0, 0, 0], after.quaternion) * Pose([0, 0, 0], before.quaternion).inverse()
            slope = np.append(after.translation - before.translation, turn.rotvec) / (2 * step)
            np.testing.assert_allclose(jacobian[:, c], slope, atol=1e-8)


@extras
def test_both_give_the_same_answers(pair: Pair) -> None:
    arm, own, other = pair
    home, random = np.array(arm.home), np.random.default_rng(1)
    goals = own.forward_batch(random_of(own, 20))
    near = own.forward_batch(home + random.uniform(-0.05, 0.05, (10, own.dof)))
    near[5:, :3] += [0.0, 0.0, 3.0]
    follow = freedom_of(own, best_effort=True, preferred=home, max_step=np.full(own.dof, 0.05))
    for targets, options in ((goals, freedom_of(own, restarts=20)), (near, follow), (near, IkOptions(restarts=1))):
        for target in targets:
            first, second = (one.inverse(Pose.from_tquat(target), home, options) for one in (own, other))
            assert first.status == second.status
            np.testing.assert_allclose(first.joints, second.joints, atol=1e-4)


@extras
def test_velocities_come_from_the_same_jacobian(pair: Pair) -> None:
    arm, own, other = pair
    home, twist = np.array(arm.home), np.array([0.05, -0.02, 0.04, 0.1, 0.0, -0.1])
    np.testing.assert_allclose(own.velocities(home, twist).joints, other.velocities(home, twist).joints, atol=1e-6)


@extras
def test_several_threads_share_one() -> None:
    arm: Any = lookup.find("arm", "fr3")
    solver = kinematics_of(arm, backend="pinocchio")
    rows = random_of(solver, 30)
    expected = [solver.forward(row) for row in rows]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(solver.forward, [*rows] * 4)) == expected * 4


@extras
def test_anchors_references_slides_and_joints_that_stay_are_understood() -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><body name="base" pos="0.1 0.2 0.3" euler="10 20 30">
        <body pos="0 0 0.2" euler="0 30 0"><joint name="a" axis="0 1 1" pos="0.05 0 0.01" ref="20"/>
          <geom size="0.01"/>
          <body pos="0.1 0 0.1"><joint name="fixed" axis="1 0 0"/><joint name="b" type="slide" axis="1 1 0" ref="0.1"/>
            <geom size="0.01"/>
            <body pos="0 0.1 0.1" euler="40 0 0"><joint name="c" axis="0 0 1" pos="0 0.1 0"/><geom size="0.01"/>
              <site name="tcp" pos="0.01 0.02 0.03" euler="5 6 7"/></body></body></body>
      </body></worldbody></mujoco>""")
    ids = [model.joint(name).id for name in ("c", "a", "b")]
    chain = (model, ids, model.site("tcp").id, model.body("base").id)
    own, other = DampedLeastSquares(*chain), PinocchioKinematics(*chain)
    for joints in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        assert own.forward(joints).is_close(other.forward(joints), 1e-9, 1e-9)
        np.testing.assert_allclose(own.jacobian(joints), other.jacobian(joints), atol=1e-9)
    apart = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><body><joint/><geom size="0.01"/><site/></body><body/></worldbody></mujoco>""")
    with pytest.raises(InvalidSetup, match="does not carry the TCP"):
        PinocchioKinematics(apart, [0], 0, 2)


def test_without_pinocchio_the_extra_is_named(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    arm: Any = lookup.find("arm", "ur5e")
    with pytest.raises(MissingDependency, match=r"robot-control-stack\[pinocchio\]"):
        kinematics_of(arm, backend="pinocchio")


def test_an_unknown_backend_is_refused() -> None:
    arm: Any = lookup.find("arm", "ur5e")
    unknown: Any = "kdl"
    with pytest.raises(InvalidSetup, match="valid: 'mujoco', 'pinocchio'"):
        kinematics_of(arm, backend=unknown)
