"""Laws of moving the TCP at a velocity, on every arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.kinematics import IkStatus, Kinematics, VelocityOptions, kinematics_of
from rcs.robots.description import ArmDescription
from rcs.spatial import Pose, distance

ARMS = {"fr3": "franka_hand", "ur5e": "robotiq_2f85", "xarm7": "robotiq_2f85", "so101": "so101_gripper"}
PERIOD = 1 / 30
Arm = tuple[ArmDescription, Kinematics]


@pytest.fixture(scope="module", params=ARMS)
def arm(request: Any) -> Arm:
    description: Any = lookup.find("arm", request.param)
    return description, kinematics_of(description, lookup.find("gripper", ARMS[request.param]))


def options_of(arm: Arm, **more: Any) -> VelocityOptions:
    preferred = np.array(arm[0].home) if arm[1].dof > 6 else None
    return VelocityOptions(max_velocity=np.array(arm[0].velocity_limit), preferred=preferred, **more)


def random_of(arm: Arm, count: int, *, share: float = 1.0) -> NDArray[np.float64]:
    """Joints anywhere within a share of their ranges, drawn at random."""
    middle = 0.5 * (arm[1].joint_lower + arm[1].joint_upper)
    half = 0.5 * share * (arm[1].joint_upper - arm[1].joint_lower)
    return np.random.default_rng(3).uniform(middle - half, middle + half, (count, arm[1].dof))


def moved(pose: Pose, twist: NDArray[np.float64], duration: float) -> Pose:
    turn = Pose.from_rotvec([0.0, 0.0, 0.0], twist[3:] * duration) * Pose([0.0, 0.0, 0.0], pose.quaternion)
    return Pose(pose.translation + twist[:3] * duration, turn.quaternion)


def test_velocities_move_the_tcp_at_the_twist_wherever_the_status_says_so(arm: Arm) -> None:
    kinematics = arm[1]
    options = options_of(arm)
    rng = np.random.default_rng(1)
    met = 0
    for joints in random_of(arm, 300, share=0.9):
        twist = rng.normal(size=6) * np.repeat([0.2, 0.5], 3)
        answer = kinematics.velocities(joints, twist, options)
        assert (np.abs(answer.joints) <= np.array(arm[0].velocity_limit) * (1 + 1e-9)).all()
        step = 1e-6
        before, after = (kinematics.forward(joints + sign * step * answer.joints) for sign in (-1, 1))
        turn = (Pose([0, 0, 0], after.quaternion) * Pose([0, 0, 0], before.quaternion).inverse()).rotvec
        missed = np.append(after.translation - before.translation, turn) / (2 * step) - answer.share * twist
        np.testing.assert_allclose(np.linalg.norm(missed[:3]), answer.translation_error, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(missed[3:]), answer.rotation_error, atol=1e-6)
        if answer.status != IkStatus.nearest:
            met += 1
            assert np.linalg.norm(missed if kinematics.dof >= 6 else missed[:3]) <= 1.1e-4 * np.linalg.norm(twist)
            assert (answer.share < 1.0) == (answer.status == IkStatus.clamped)
    assert met >= 150


def test_all_joints_are_slowed_down_alike(arm: Arm) -> None:
    home, twist = np.array(arm[0].home), np.array([0.3, 0.2, -0.1, 0.0, 0.0, 0.0])
    free = arm[1].velocities(home, twist)
    bound = 0.25 * np.abs(free.joints).max()
    slow = arm[1].velocities(home, twist, VelocityOptions(max_velocity=np.full(arm[1].dof, bound)))
    assert slow.status == IkStatus.clamped
    np.testing.assert_allclose(slow.share, 0.25)
    np.testing.assert_allclose(slow.joints, 0.25 * free.joints, atol=1e-12)


def test_an_advance_is_a_straight_line_and_a_turn_about_one_axis_and_steps_add_up(arm: Arm) -> None:
    kinematics, home = arm[1], np.array(arm[0].home)
    twist = np.array([0.06, 0.04, -0.05, 0.2, -0.1, 0.3]) * (1.0 if kinematics.dof >= 6 else 0.5)
    if kinematics.dof < 6:
        twist[3:] = 0.0
    start = kinematics.forward(home)
    joints = home
    for i in range(30):
        answer = kinematics.advance(joints, twist, PERIOD, options_of(arm))
        assert answer.status == IkStatus.ok
        joints = answer.joints
        goal = moved(start, twist, (i + 1) * PERIOD)
        here = kinematics.forward(joints)
        assert here.distance_to(goal) < (1e-8 if kinematics.dof >= 6 else 1e-4)
        if kinematics.dof >= 6:
            assert here.angle_to(goal) < 1e-8
    at_once = kinematics.advance(home, twist, 1.0, VelocityOptions())
    miss = kinematics.forward(at_once.joints).distance_to(moved(start, twist, 1.0))
    assert miss < (1e-8 if kinematics.dof >= 6 else 1e-4)
    np.testing.assert_allclose(at_once.translation_error, miss, atol=1e-12)


def test_there_and_back_the_elbow_is_where_it_was(arm: Arm) -> None:
    home = np.array(arm[0].home)
    joints = home
    for lap in range(20):
        for sign in (1, -1):
            twist = sign * np.array([0.1, 0.1 * (lap % 3 - 1), -0.05, 0.0, 0.0, 0.0])
            for _ in range(15):
                joints = arm[1].advance(joints, twist, PERIOD, options_of(arm)).joints
    assert np.abs(joints - home).max() < 0.05


def test_at_zero_nothing_moves(arm: Arm) -> None:
    for joints in random_of(arm, 20):
        answer = arm[1].advance(joints, np.zeros(6), 1.0, options_of(arm))
        assert answer.status == IkStatus.ok
        np.testing.assert_array_equal(answer.joints, joints)
        assert (arm[1].velocities(joints, np.zeros(6), options_of(arm)).joints == 0.0).all()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_at_the_end_of_the_reach_it_stops_keeps_the_tool_and_comes_back_at_once(
    arm: Arm, axis: int, sign: float
) -> None:
    description, kinematics = arm
    joints = np.array(description.home)
    start = kinematics.forward(joints)
    twist = np.zeros(6)
    twist[axis] = 0.25 * sign
    options = options_of(arm)
    step = np.array(description.velocity_limit) * PERIOD
    for _ in range(240):
        answer = kinematics.advance(joints, twist, PERIOD, options)
        assert (np.abs(answer.joints - joints) <= step * (1 + 1e-9)).all()
        assert (answer.joints >= kinematics.joint_lower).all()
        assert (answer.joints <= kinematics.joint_upper).all()
        joints = answer.joints
    assert answer.status == IkStatus.nearest
    end = kinematics.forward(joints)
    if kinematics.dof >= 6:
        assert end.angle_to(start) < 0.1, "what nobody asked for is kept"
    for _ in range(15):
        joints = kinematics.advance(joints, -twist, PERIOD, options).joints
    assert abs(kinematics.forward(joints).translation[axis] - end.translation[axis]) > 0.02


def test_a_joint_outside_its_limits_stays_or_comes_back(arm: Arm) -> None:
    description, kinematics = arm
    start = np.array(description.home)
    start[1] = kinematics.joint_upper[1] + 0.1
    options = options_of(arm)
    np.testing.assert_array_equal(kinematics.advance(start, np.zeros(6), PERIOD, options).joints, start)
    ends = [kinematics.advance(start, twist, PERIOD, options).joints for twist in np.vstack([np.eye(6), -np.eye(6)])]
    assert all(end[1] <= start[1] for end in ends)
    assert min(end[1] for end in ends) < start[1]
    assert all(
        (np.abs(end - start) <= np.array(description.velocity_limit) * PERIOD * (1 + 1e-9)).all() for end in ends
    )


@pytest.mark.parametrize("threads", [1, 3])
def test_a_batch_is_a_loop_and_wild_twists_from_anywhere_stay_within_all_bounds(arm: Arm, threads: int) -> None:
    description, kinematics = arm
    rng = np.random.default_rng(7)
    starts = random_of(arm, 3000)
    lower, upper = kinematics.joint_lower, kinematics.joint_upper
    starts[::3] = np.where(
        rng.random(starts[::3].shape) < 0.4, np.clip(0.0, lower, upper), starts[::3]
    )  # singular ones
    starts[::5] = np.where(rng.random(starts[::5].shape) < 0.5, lower, upper)
    twists = rng.normal(size=(len(starts), 6)) * 10.0 ** rng.uniform(-6, 3, (len(starts), 1))
    twists[::7, 3:] = 0.0
    twists[1::7, :3] = 0.0
    options = options_of(arm)
    joints, status, errors = kinematics.advance_batch(starts, twists, PERIOD, options, threads)
    assert np.isfinite(joints).all()
    assert np.isfinite(errors).all()
    assert ((joints >= lower) & (joints <= upper)).all()
    assert (np.abs(joints - starts) <= np.array(description.velocity_limit) * PERIOD * (1 + 1e-9)).all()
    assert set(status) == {IkStatus.ok.value, IkStatus.clamped.value, IkStatus.nearest.value}
    for i in range(0, len(starts), 100):
        one = kinematics.advance(starts[i], twists[i], PERIOD, options)
        np.testing.assert_array_equal(one.joints, joints[i])
        np.testing.assert_array_equal([one.translation_error, one.rotation_error], errors[i])
    goals = np.array([moved(kinematics.forward(q), t, PERIOD).tquat for q, t in zip(starts, twists, strict=True)])
    is_ok = status == IkStatus.ok.value
    miss = distance(kinematics.forward_batch(joints), goals)
    np.testing.assert_allclose(errors[is_ok], miss[is_ok], atol=2e-7)
    if kinematics.dof >= 6:
        assert miss[is_ok].max() < 1e-4


def test_kinematics_in_python_move_at_velocities_too() -> None:
    class Gantry(Kinematics):
        def _dof(self) -> int:
            return 3

        def _joint_lower(self) -> list[float]:
            return [-1.0] * 3

        def _joint_upper(self) -> list[float]:
            return [1.0] * 3

        def _forward(self, joints: Any) -> Pose:
            return Pose(joints)

        def _jacobian(self, joints: Any) -> Any:
            return np.eye(6, 3)

    answer = Gantry().advance(np.zeros(3), np.array([0.5, 0.0, 0.8, 0.0, 0.0, 0.0]), 2.0)
    assert answer.status == IkStatus.nearest
    np.testing.assert_allclose(answer.joints, [1.0, 0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize(
    ("twist", "duration", "options"),
    [
        (np.full(6, np.nan), 1.0, {}),
        (np.zeros(5), 1.0, {}),
        (np.zeros(6), -1.0, {}),
        (np.zeros(6), np.nan, {}),
        (np.zeros(6), 1.0, {"max_velocity": np.ones(3)}),
        (np.zeros(6), 1.0, {"preferred": np.ones(3)}),
    ],
)
def test_what_makes_no_sense_is_refused(arm: Arm, twist: Any, duration: float, options: Any) -> None:
    with pytest.raises(InvalidSetup):
        arm[1].advance(np.array(arm[0].home), twist, duration, VelocityOptions(**options))


@pytest.mark.parametrize(
    "bad",
    [{"max_velocity": np.zeros(1)}, {"damping": 0.0}, {"preferred": np.full(1, np.nan)}, {"preferred_weight": -1.0}],
)
def test_options_that_make_no_sense_are_refused(bad: Any) -> None:
    with pytest.raises(InvalidSetup, match="VelocityOptions"):
        VelocityOptions(**bad)


def test_kinematics_in_python_with_too_few_limits_are_refused() -> None:
    class Short(Kinematics):
        def _dof(self) -> int:
            return 3

        def _joint_lower(self) -> list[float]:
            return [-1.0] * 2

        def _joint_upper(self) -> list[float]:
            return [1.0] * 3

        def _forward(self, joints: Any) -> Pose:
            return Pose(joints)

    for call in (
        lambda: Short().advance(np.zeros(3), np.ones(6) * 0.1, 0.1),
        lambda: Short().velocities(np.zeros(3), np.ones(6) * 0.1),
        lambda: Short().inverse(Pose(), np.zeros(3)),
    ):
        with pytest.raises(InvalidSetup, match="2 limits, the arm has 3 joints"):
            call()


@pytest.mark.parametrize("threads", [1, 2])
def test_twists_beyond_all_numbers_are_an_error_on_every_thread(arm: Arm, threads: int) -> None:
    with pytest.raises(ValueError, match="finite"):
        arm[1].advance_batch(np.tile(arm[0].home, (2, 1)), np.full((2, 6), 1e200), 0.1, threads=threads)
