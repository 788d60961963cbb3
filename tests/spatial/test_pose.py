"""Laws of Pose: group axioms, round trips, log and exp, interpolation, value semantics, refusals."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcs.spatial import Pose

coordinates = st.floats(-10.0, 10.0, allow_subnormal=False)
points = st.tuples(coordinates, coordinates, coordinates)


@st.composite
def rotvecs(draw: st.DrawFn, max_angle: float = math.pi) -> npt.NDArray[np.float64]:
    """Draw rotation vectors of every size, angles near 0 and near the largest one as likely as the others."""
    axis = np.array(draw(points.filter(lambda p: math.hypot(*p) > 1e-3)))
    exponent = draw(st.floats(-12.0, 0.0))
    part = 10.0**exponent if draw(st.booleans()) else 1.0 - 10.0**exponent
    return axis / np.linalg.norm(axis) * max_angle * part


poses = st.builds(Pose.from_rotvec, points, rotvecs())


def is_same(a: Pose, b: Pose, tolerance: float = 1e-12) -> bool:
    return a.is_close(b, metres=tolerance * 100, radians=tolerance)


@given(poses, poses, poses)
def test_composition_is_associative(a: Pose, b: Pose, c: Pose) -> None:
    assert is_same((a * b) * c, a * (b * c))


@given(poses)
def test_the_identity_changes_nothing(pose: Pose) -> None:
    assert is_same(pose * Pose(), pose)
    assert is_same(Pose() * pose, pose)


@given(poses)
def test_a_pose_times_its_inverse_is_the_identity(pose: Pose) -> None:
    assert is_same(pose * pose.inverse(), Pose())
    assert is_same(pose.inverse() * pose, Pose())


@given(poses, poses, points)
def test_a_product_applies_its_right_factor_first(a: Pose, b: Pose, point: tuple[float, float, float]) -> None:
    np.testing.assert_allclose((a * b).apply(point), a.apply(b.apply(point)), atol=1e-12)


@given(poses, poses)
def test_matrices_multiply_as_poses_do(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose((a * b).matrix, a.matrix @ b.matrix, atol=1e-12)
    np.testing.assert_allclose(a.inverse().matrix, np.linalg.inv(a.matrix), atol=1e-12)


@given(poses)
def test_every_representation_gives_the_pose_back(pose: Pose) -> None:
    assert Pose.from_tquat(pose.tquat) == pose
    assert is_same(Pose.from_matrix(pose.matrix), pose)
    assert is_same(Pose.from_rpy(pose.translation, pose.rpy), pose)
    assert is_same(Pose.from_xyzrpy(pose.xyzrpy), pose)
    assert is_same(Pose.from_rotvec(pose.translation, pose.rotvec), pose)


@given(poses)
def test_exp_of_log_gives_the_pose_back(pose: Pose) -> None:
    assert is_same(Pose.exp(pose.log()), pose)


@given(points, rotvecs(max_angle=math.pi - 1e-6))
def test_log_of_exp_gives_the_twist_back(v: tuple[float, float, float], w: npt.NDArray[np.float64]) -> None:
    twist = np.concatenate([v, w])
    # At an angle of pi the axis may flip; 1e-6 short of it, the rounding of w in the quaternion still costs nothing.
    np.testing.assert_allclose(Pose.exp(twist).log(), twist, atol=1e-12)


@given(st.floats(-math.pi, math.pi), st.floats(-1.57, 1.57), st.floats(-math.pi, math.pi))
def test_roll_pitch_yaw_turn_about_fixed_axes_in_that_order(roll: float, pitch: float, yaw: float) -> None:
    about_x = Pose.from_rotvec((0, 0, 0), (roll, 0, 0))
    about_y = Pose.from_rotvec((0, 0, 0), (0, pitch, 0))
    about_z = Pose.from_rotvec((0, 0, 0), (0, 0, yaw))
    assert is_same(Pose.from_rpy((0, 0, 0), (roll, pitch, yaw)), about_z * about_y * about_x)


@given(st.floats(-3.1, 3.1), st.floats(-1.57, 1.57), st.floats(-3.1, 3.1))
def test_roll_pitch_yaw_come_back_as_they_were(roll: float, pitch: float, yaw: float) -> None:
    # The nearer pitch is to pi/2, the less roll and yaw are determined one by one: 1e-16 over the distance of 1e-3.
    np.testing.assert_allclose(Pose.from_rpy((0, 0, 0), (roll, pitch, yaw)).rpy, (roll, pitch, yaw), atol=1e-11)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_in_gimbal_lock_roll_is_zero_and_the_rotation_is_right(pitch: float) -> None:
    pose = Pose.from_rpy((0, 0, 0), (0.3, pitch, 0.5))
    assert pose.rpy[0] == 0.0
    assert pose.rpy[1] == pytest.approx(pitch, abs=1e-12)
    assert is_same(Pose.from_rpy((0, 0, 0), pose.rpy), pose)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (-0.6, 0.8, 0.0)])
@pytest.mark.parametrize("short_of_pi", [0.0, 1e-15, 1e-9, 1e-4])
def test_half_turns_keep_their_axis_and_angle(axis: tuple[float, float, float], short_of_pi: float) -> None:
    pose = Pose.from_rotvec((1, 2, 3), (math.pi - short_of_pi) * np.array(axis))
    assert np.linalg.norm(pose.rotvec) == pytest.approx(math.pi - short_of_pi, abs=1e-14)
    assert abs(float(pose.rotvec @ axis)) == pytest.approx(math.pi - short_of_pi, abs=1e-14)
    assert is_same(Pose.from_matrix(pose.matrix), pose)
    assert is_same(Pose.exp(pose.log()), pose)


@given(poses, st.floats(1e-7, 1e-5))
def test_log_is_the_derivative_of_exp(pose: Pose, step: float) -> None:
    twist = pose.log()
    velocity = Pose.exp(twist * (1 + step)).matrix - Pose.exp(twist * (1 - step)).matrix
    vx, vy, vz, wx, wy, wz = twist
    generator = np.array([[0, -wz, wy, vx], [wz, 0, -wx, vy], [-wy, wx, 0, vz], [0, 0, 0, 0]])
    np.testing.assert_allclose(velocity / (2 * step), pose.matrix @ generator, atol=2e-7)


@given(poses, poses)
def test_interpolation_starts_and_ends_at_its_end_points(a: Pose, b: Pose) -> None:
    assert a.interpolate(b, 0.0) == a
    assert a.interpolate(b, 1.0) == b


@given(poses, poses, st.floats(0.0, 1.0))
def test_interpolation_has_constant_speed(a: Pose, b: Pose, fraction: float) -> None:
    between = a.interpolate(b, fraction)
    assert a.distance_to(between) == pytest.approx(fraction * a.distance_to(b), abs=1e-12)
    assert a.angle_to(between) == pytest.approx(fraction * a.angle_to(b), abs=1e-12)
    assert between.angle_to(b) == pytest.approx((1 - fraction) * a.angle_to(b), abs=1e-12)


@given(poses, poses)
def test_angle_and_distance_are_those_of_the_way_between(a: Pose, b: Pose) -> None:
    way = a.inverse() * b
    assert a.angle_to(b) == pytest.approx(float(np.linalg.norm(way.rotvec)), abs=1e-12)
    assert a.distance_to(b) == pytest.approx(float(np.linalg.norm(way.translation)), abs=1e-12)


def test_being_close_needs_both_the_distance_and_the_angle() -> None:
    pose = Pose.from_rotvec((0.1, 0, 0), (0, 0.2, 0))
    assert pose.is_close(Pose(), metres=0.11, radians=0.21)
    assert not pose.is_close(Pose(), metres=0.09, radians=0.21)
    assert not pose.is_close(Pose(), metres=0.11, radians=0.19)


@given(poses)
def test_a_quaternion_and_its_negative_are_the_same_pose(pose: Pose) -> None:
    twin = Pose(pose.translation, -pose.quaternion)
    assert twin == pose
    assert hash(twin) == hash(pose)
    assert pose.quaternion[3] >= 0


@given(poses)
def test_a_pose_survives_pickle_copy_and_repr_to_the_bit(pose: Pose) -> None:
    assert pickle.loads(pickle.dumps(pose)) == pose
    assert copy.copy(pose) == pose
    assert copy.deepcopy(pose) == pose
    assert eval(repr(pose), {"Pose": Pose}) == pose


def test_poses_differ_from_other_poses_and_from_other_things() -> None:
    assert Pose((0, 0, 1e-300)) != Pose()
    assert Pose((0.0, 0.0, -0.0)) == Pose()
    assert Pose() != "a pose"
    assert len({Pose(), Pose((0, 0, 0)), Pose((1, 0, 0))}) == 2


def test_a_pose_does_not_change() -> None:
    pose = Pose((1, 2, 3))
    pose.translation[0] = 9.0
    pose.matrix[0, 3] = 9.0
    assert pose == Pose((1, 2, 3))
    with pytest.raises(AttributeError):
        pose.translation = np.zeros(3)  # pyright: ignore[reportAttributeAccessIssue]


def test_points_are_applied_in_any_leading_shape() -> None:
    pose = Pose.from_rpy((1, 2, 3), (0.1, 0.2, 0.3))
    cloud = np.random.default_rng(0).normal(size=(2, 5, 3))
    expected = cloud @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]
    np.testing.assert_allclose(pose.apply(cloud), expected, atol=1e-14)
    assert pose.apply(np.empty((0, 3))).shape == (0, 3)


def test_a_rounded_quaternion_is_normalised() -> None:
    quaternion = Pose(quaternion=np.array([0.5, 0.5, 0.5, 0.5004], dtype=np.float32)).quaternion
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)


MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
SHEARED = np.eye(4) + 1e-5 * np.eye(4, k=1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pose((0, 0)), r"translation must have the shape \(3,\), got \(2,\)"),
        (lambda: Pose((0, 0, math.nan)), r"translation must be 3 finite numbers, got \(0, 0, nan\)"),
        (lambda: Pose(quaternion=(0, 0, 0, math.inf)), "quaternion must be 4 finite numbers"),
        (lambda: Pose(quaternion=(0, 0, 0, 1.01)), r"norm 1 within 1e-3, got \(0, 0, 0, 1.01\) of norm 1.01"),
        (lambda: Pose(quaternion=(0, 0, 0, 0)), "of norm 0"),
        (lambda: Pose.from_tquat(np.zeros((1, 7))), r"\(7,\), got \(1, 7\)"),
        (lambda: Pose.from_rpy((0, 0, 0), (0, math.inf, 0)), "rpy must be 3 finite numbers"),
        (lambda: Pose.from_rotvec((0, 0, 0), (0, math.nan, 0)), "rotation vector must be 3 finite numbers"),
        (lambda: Pose.exp((0, 0, 0, 1e200, 0, 0)), "rotation vector must have a length"),
        (lambda: Pose.from_matrix(np.eye(3)), r"\(4, 4\), got \(3, 3\)"),
        (lambda: Pose.from_matrix(MIRROR), "matrix must be a rotation"),
        (lambda: Pose.from_matrix(SHEARED), "matrix must be a rotation"),
        (lambda: Pose().interpolate(Pose(), 1.5), r"fraction must be in \[0, 1\], got 1.5"),
        (lambda: Pose().interpolate(Pose(), math.nan), r"fraction must be in \[0, 1\]"),
        (lambda: Pose().apply((1, 2)), r"points must have the shape \(..., 3\), got \(2,\)"),
    ],
)
def test_bad_numbers_are_refused_with_what_came_and_what_is_valid(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
