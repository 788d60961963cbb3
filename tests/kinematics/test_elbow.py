from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.kinematics import Elbow, IkOptions, IkStatus, Kinematics, kinematics_of

Arm = tuple[Any, Kinematics]


@pytest.fixture(scope="module", params=["fr3", "xarm7"])
def arm(request: Any) -> Arm:
    description: Any = lookup.find("arm", request.param)
    return description, kinematics_of(description)


def inner(arm: Arm, count: int) -> np.ndarray:
    lower, upper = arm[1].joint_lower, arm[1].joint_upper
    return np.random.default_rng(4).uniform(0.7 * lower + 0.3 * upper, 0.3 * lower + 0.7 * upper, (count, 7))


def test_to_move_the_elbow_leaves_the_tcp_and_changes_the_angle_by_what_was_asked_for(arm: Arm) -> None:
    description, kinematics = arm
    elbow = Elbow(kinematics)
    home = np.array(description.home)
    for by in (0.5, -0.5, 0.02, 0.0):
        answer = elbow.move(home, by)
        assert answer.status == IkStatus.ok
        here, there = kinematics.forward(home), kinematics.forward(answer.joints)
        assert there.distance_to(here) < 1e-6
        assert there.angle_to(here) < 1e-6
        np.testing.assert_allclose(np.sin(elbow.angle(answer.joints) - elbow.angle(home) - by), 0.0, atol=2e-4)
        np.testing.assert_allclose(elbow.move(answer.joints, -by).joints, home, atol=1e-3)


def test_with_the_elbow_up_the_angle_is_0_and_of_mirrored_postures_the_opposite(arm: Arm) -> None:
    description, kinematics = arm
    elbow = Elbow(kinematics)
    home = np.array(description.home)
    assert abs(home[0]) + abs(home[2]) + abs(home[4]) < 1e-9, "the arm is in the vertical plane"
    np.testing.assert_allclose(elbow.angle(home), 0.0, atol=1e-9)
    sideways = home + np.array([0.2, 0.0, 0.3, 0.0, -0.2, 0.0, 0.0])
    mirrored = home - np.array([0.2, 0.0, 0.3, 0.0, -0.2, 0.0, 0.0])
    assert abs(elbow.angle(sideways)) > 0.05
    np.testing.assert_allclose(elbow.angle(mirrored), -elbow.angle(sideways), atol=1e-9)


def test_the_first_joint_does_not_change_the_angle(arm: Arm) -> None:
    elbow = Elbow(arm[1])
    for joints in inner(arm, 20):
        other = joints.copy()
        other[0] += 0.3
        np.testing.assert_allclose(elbow.angle(other), elbow.angle(joints), atol=1e-9)


def test_the_direction_leaves_the_tcp_and_raises_the_angle(arm: Arm) -> None:
    elbow = Elbow(arm[1])
    for joints in inner(arm, 30):
        way = elbow.direction(joints)
        np.testing.assert_allclose(arm[1].jacobian(joints) @ way, 0.0, atol=1e-9)
        gained = elbow.angle(joints + 1e-4 * way) - elbow.angle(joints - 1e-4 * way)
        assert np.sin(gained) >= 0.0


def test_the_elbow_stops_at_a_joints_limit(arm: Arm) -> None:
    _, kinematics = arm
    elbow = Elbow(kinematics)
    stopped = 0
    for joints in inner(arm, 3):
        for by in (-6.0, 6.0):
            answer = elbow.move(joints, by)
            assert (answer.joints >= kinematics.joint_lower).all()
            assert (answer.joints <= kinematics.joint_upper).all()
            assert answer.translation_error < 1e-6
            assert answer.rotation_error < 1e-6
            stopped += answer.status == IkStatus.clamped
    assert stopped >= 3


def test_a_pose_is_reached_with_the_elbow_where_it_is_wanted(arm: Arm) -> None:
    description, kinematics = arm
    elbow = Elbow(kinematics)
    home = np.array(description.home)
    target = kinematics.forward(home + np.array([0.2, 0.1, -0.1, 0.1, 0.1, -0.1, 0.2]))
    for wanted in elbow.angle(home) + np.array([-0.4, 0.0, 0.4]):
        answer = elbow.inverse(target, home, wanted, IkOptions(restarts=0))
        assert answer.status == IkStatus.ok
        assert kinematics.forward(answer.joints).distance_to(target) < 2e-4
        np.testing.assert_allclose(np.sin(elbow.angle(answer.joints) - wanted), 0.0, atol=2e-4)


def test_an_arm_with_six_joints_has_no_elbow_to_move() -> None:
    arm: Any = lookup.find("arm", "ur5e")
    with pytest.raises(InvalidSetup, match="has 6 joints; only with 7"):
        Elbow(kinematics_of(arm))
