"""Laws of following a target with the TCP, on every arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import lookup
from rcs.kinematics import IkStatus, Kinematics, freedom_of, kinematics_of
from rcs.robots.description import ArmDescription
from rcs.spatial import Pose, distance

ARMS = {"fr3": "franka_hand", "ur5e": "robotiq_2f85", "xarm7": "robotiq_2f85", "so101": "so101_gripper"}
Row = NDArray[np.float64]


@pytest.fixture(scope="module", params=ARMS)
def arm(request: Any) -> tuple[ArmDescription, Kinematics]:
    description: Any = lookup.find("arm", request.param)
    gripper: Any = lookup.find("gripper", ARMS[request.param])
    return description, kinematics_of(description, gripper)


def follow(arm: tuple[ArmDescription, Kinematics], targets: Row, frequency: float = 30.0) -> tuple[Row, Row]:
    """Return the joints, from home on, and the status of each target."""
    description, kinematics = arm
    step = np.array(description.velocity_limit) / frequency
    options = freedom_of(kinematics, best_effort=True, preferred=description.home, max_step=step)
    joints, found = [np.array(description.home)], []
    for target in targets:
        solved, status, _ = kinematics.inverse_batch(target[None], joints[-1][None], options)
        joints.append(solved[0])
        found.append(status[0])
    return np.array(joints), np.array(found)


@pytest.mark.parametrize("frequency", [10.0, 30.0, 100.0])
def test_the_elbow_does_not_drift_on_a_circle(arm: Any, frequency: float) -> None:
    description, kinematics = arm
    start = kinematics.forward(np.array(description.home)).tquat
    lap, laps = round(4 * frequency), 30 if frequency == 30.0 else 3
    angles = 2 * np.pi * np.arange(1, lap * laps + 1) / lap
    radius = 0.12 if description.name != "so101" else 0.03
    targets = np.tile(start, (len(angles), 1))
    targets[:, :2] += radius * np.stack([np.cos(angles) - 1, np.sin(angles)], axis=-1)
    joints, status = follow(arm, targets, frequency)
    assert (status == IkStatus.ok.value).all()
    miss = distance(kinematics.forward_batch(joints[1:]), targets)
    assert miss[:, 0].max() < (1e-5 if description.dof >= 6 else 5e-4)
    drift = np.abs(joints[lap::lap] - joints[0]).max(axis=-1)
    assert drift.max() <= 0.2
    assert abs(drift[-1] - drift[1]) < 0.01, "it does not grow"


def test_on_straight_paths_no_joint_exceeds_its_speed_and_the_tcp_stays_on_the_line(arm: Any) -> None:
    description, kinematics = arm
    start = kinematics.forward(np.array(description.home)).tquat
    limit = np.array(description.velocity_limit) / 30
    rng = np.random.default_rng(4)
    straight = 0
    for _ in range(12):
        way = rng.normal(size=3)
        way *= (
            rng.uniform(0.3, 1.2) * np.linalg.norm(start[:3]) / np.linalg.norm(way)
        )  # out of reach, too, and past the base
        shares = np.minimum(
            1.0, np.arange(1, int(np.linalg.norm(way) / 0.25 * 30) + 30) * 0.25 / 30 / np.linalg.norm(way)
        )
        targets = np.tile(start, (len(shares), 1))
        targets[:, :3] += shares[:, None] * way
        joints, status = follow(arm, targets)
        assert (np.abs(np.diff(joints, axis=0)) <= limit + 1e-12).all()
        if (status != IkStatus.nearest.value).all():
            miss = kinematics.forward_batch(joints[1:])[:, :3] - start[:3]
            beside = miss - (miss @ way)[:, None] / (way @ way) * way
            # Near singular postures, what would take too long is given up; elsewhere the line is exact.
            exact = 1e-5 if description.dof >= 6 else 5e-4
            slow = 5e-3 if description.dof >= 6 else 1e-2
            assert np.abs(beside).max() < (exact if (status == IkStatus.ok.value).all() else slow)
            straight += 1
    assert straight >= 3


def test_a_small_motion_is_made_and_not_put_off(arm: Any) -> None:
    description, kinematics = arm
    target = kinematics.forward(np.array(description.home)).tquat
    target[2] += 5e-5
    if description.dof < 6:
        pytest.skip("meets the translation to within half a millimetre")
    joints, status = follow(arm, target[None])
    assert status[0] == IkStatus.ok.value
    assert distance(kinematics.forward(joints[1]).tquat, target)[0] < 1e-5


def test_the_next_pose_of_a_stream_is_found_in_a_few_iterations(arm: Any) -> None:
    description, kinematics = arm
    home = np.array(description.home)
    step = np.array(description.velocity_limit) / 30
    options = freedom_of(kinematics, best_effort=True, preferred=home, max_step=step)
    rng = np.random.default_rng(0)
    iterations = []
    for _ in range(50):
        target = kinematics.forward(home + rng.uniform(-0.3, 0.3, len(home)) * step)
        iterations.append(kinematics.inverse(target, home, options).iterations)
    assert np.mean(iterations) <= 8


def test_a_small_step_well_within_reach_is_met(arm: Any) -> None:
    description, kinematics = arm
    if description.dof < 6:
        pytest.skip("meets the translation to within half a millimetre")
    random = np.random.default_rng(0)
    options = freedom_of(kinematics, best_effort=True, preferred=description.home)
    for _ in range(2000):
        joints = np.array(description.home) + random.uniform(-0.5, 0.5, description.dof)
        if np.linalg.svd(kinematics.jacobian(joints))[1][-1] < 0.05:
            continue  # near a singular posture
        turn = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, random.uniform(-0.06, 0.06)))
        now = kinematics.forward(joints)
        target = Pose(now.translation + random.normal(0.0, 1e-3, 3), (turn * now).quaternion)
        assert kinematics.inverse(target, joints, options).status == IkStatus.ok, joints


def test_a_pose_that_is_reached_moves_nothing_wherever_the_elbow_is() -> None:
    description: Any = lookup.find("arm", "fr3")
    solver = kinematics_of(description)
    joints = np.array(description.home) + 0.3
    options = freedom_of(solver, best_effort=True, preferred=description.home)
    result = solver.inverse(solver.forward(joints), joints, options)
    np.testing.assert_array_equal(result.joints, joints)


def test_a_push_against_the_end_of_the_reach_does_not_turn_the_tool_of_an_arm_with_six_joints() -> None:
    # Each action counts from where the last one came to, as relative actions do.
    description: Any = lookup.find("arm", "ur5e")
    solver = kinematics_of(description)
    options = freedom_of(solver, best_effort=True, max_step=np.full(6, 0.1))
    joints = np.array(description.home)
    start = solver.forward(joints).tquat
    for _ in range(150):
        target = solver.forward(joints).tquat
        target[1] += 0.02
        result = solver.inverse(Pose.from_tquat(target), joints, options)
        joints = result.joints
    assert result.status == IkStatus.nearest
    reached = solver.forward(joints).tquat
    assert reached[1] > start[1] + 0.2
    assert distance(reached, start)[1] < 0.02


def test_a_turn_against_a_joints_limit_does_not_move_the_tcp() -> None:
    description: Any = lookup.find("arm", "fr3")
    gripper: Any = lookup.find("gripper", "franka_hand")
    solver = kinematics_of(description, gripper)
    options = freedom_of(solver, best_effort=True, preferred=description.home, max_step=np.full(7, 0.1))
    joints = np.array(description.home)
    start = solver.forward(joints).tquat
    turn = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.05, 0.0))
    for _ in range(80):
        now = solver.forward(joints)
        target = Pose(now.translation, (turn * now).quaternion)
        result = solver.inverse(target, joints, options)
        joints = result.joints
    assert result.status == IkStatus.nearest
    assert distance(solver.forward(joints).tquat, start)[0] < 0.05
