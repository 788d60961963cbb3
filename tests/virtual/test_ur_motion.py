"""How the controller of a virtual UR moves: it keeps speeds, accelerations and lines, and arrives."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.kinematics import kinematics_of
from rcs.robots import UR5E
from rcs.spatial import Pose
from rcs.virtual.ur_motion import (
    Chain,
    Motion,
    Reference,
    Servo,
    SpeedJoints,
    SpeedTcp,
    Stop,
    pose_of,
    vector_of,
)

DT = 0.002
HOME = np.array(UR5E.home)
TOOL = Pose((0.0, 0.0, 0.15))


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(kinematics_of(UR5E), TOOL)


def run(motion: Motion, seconds: float, reference: Reference | None = None) -> NDArray[np.float64]:
    """Return the joints tick by tick, (ticks, 6), until the motion is over."""
    reference = reference or Reference(HOME.copy())
    rows = [reference.joints.copy()]
    for _ in range(round(seconds / DT)):
        is_over = motion.step(reference, DT)
        rows.append(reference.joints.copy())
        if is_over:
            assert not reference.velocities.any()
            return np.array(rows)
    return np.array(rows)


@pytest.mark.parametrize(("lookahead", "gain"), [(0.05, 1600.0), (0.1, 400.0), (0.2, 100.0)])
def test_a_servo_that_is_damped_enough_reaches_its_target_without_passing_it(lookahead: float, gain: float) -> None:
    target = HOME + np.array([0.01, -0.02, 0.03, 0.0, 0.01, -0.01])
    rows = run(Servo(target, lookahead, gain), 3.0) - HOME
    way = target - HOME
    assert np.allclose(rows[-1], way, atol=1e-6)
    assert (np.abs(rows) <= np.abs(way) + 1e-9).all()


def test_a_servo_comes_behind_a_moving_target_by_its_lookahead() -> None:
    servo, reference = Servo(HOME.copy(), 0.05, 1600.0), Reference(HOME.copy())
    for tick in range(1000):
        servo.target = HOME + 0.5 * DT * (tick + 1)
        servo.step(reference, DT)
    assert servo.target - reference.joints == pytest.approx(0.5 * 0.05, rel=0.05)


def test_a_speed_of_the_tcp_moves_the_tcp(chain: Chain) -> None:
    twist = np.array([0.05, 0.0, -0.02, 0.0, 0.1, 0.0])
    reference = Reference(HOME.copy())
    run(SpeedTcp(twist, 1.0, chain), 0.2, reference)
    before = chain.forward(reference.joints)
    run(SpeedTcp(twist, 1.0, chain, twist.copy()), 0.1, reference)
    after = chain.forward(reference.joints)
    assert after.translation - before.translation == pytest.approx(0.1 * twist[:3], abs=1e-4)
    assert (after * before.inverse()).rotvec == pytest.approx(0.1 * twist[3:], abs=1e-4)


def test_speeds_of_joints_are_reached_and_left_at_the_given_accelerations() -> None:
    wanted = np.array([1.0, -0.5, 0.0, 0.2, 0.0, 0.1])
    reference = Reference(HOME.copy())
    rows = run(SpeedJoints(wanted, 4.0), 1.0, reference)
    assert (reference.velocities == wanted).all()
    assert np.abs(np.diff(rows, n=2, axis=0)).max() / DT**2 <= 4.0 * 1.001
    rows = run(Stop(8.0), 1.0, reference)
    assert len(rows) * DT == pytest.approx(1.0 / 8.0, abs=2.5 * DT)


def test_poses_are_what_the_controller_writes(chain: Chain) -> None:
    pose = chain.forward(HOME)
    assert pose_of(vector_of(pose)).is_close(pose, 1e-12, 1e-9)
    assert chain.inverse(pose, HOME + 0.05) == pytest.approx(HOME, abs=1e-5)
