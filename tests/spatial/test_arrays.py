"""The functions on arrays agree with Pose row by row, keep leading shapes, and refuse what is no pose."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rcs import spatial
from rcs.spatial import Pose

Floats = np.ndarray


def random_tquats(*leading: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return spatial.normalize(rng.normal(size=(*leading, 7)))


A = random_tquats(20, seed=1)
B = random_tquats(20, seed=2)


@pytest.mark.parametrize(
    ("batched", "single"),
    [
        (spatial.compose, lambda a, b: (a * b).tquat),
        (spatial.relative, lambda a, b: (a.inverse() * b).tquat),
        (spatial.distance, lambda a, b: (a.distance_to(b), a.angle_to(b))),
        (lambda a, b: spatial.interpolate(a, b, 0.3), lambda a, b: a.interpolate(b, 0.3).tquat),
        (lambda a, _: spatial.inverse(a), lambda a, _: a.inverse().tquat),
        (lambda a, _: spatial.tquat_to_xyzrpy(a), lambda a, _: a.xyzrpy),
        (lambda a, _: spatial.tquat_to_matrix(a), lambda a, _: a.matrix),
    ],
)
def test_a_batch_is_the_loop_over_its_poses(
    batched: Callable[[Floats, Floats], Floats], single: Callable[[Pose, Pose], Floats]
) -> None:
    loop = np.array([single(Pose.from_tquat(a), Pose.from_tquat(b)) for a, b in zip(A, B, strict=True)])
    np.testing.assert_array_equal(batched(A, B), loop)
    np.testing.assert_array_equal(batched(A.reshape(4, 5, 7), B.reshape(4, 5, 7)), loop.reshape(4, 5, *loop.shape[1:]))
    for i in (0, 7):
        np.testing.assert_array_equal(batched(A[i], B[i]), loop[i])


@pytest.mark.parametrize("leading", [(), (1,), (0,), (3,), (2, 0), (2, 3), (2, 1, 3)])
def test_leading_shapes_are_kept(leading: tuple[int, ...]) -> None:
    tquat = random_tquats(*leading)
    assert spatial.compose(tquat, tquat).shape == (*leading, 7)
    assert spatial.inverse(tquat).shape == (*leading, 7)
    assert spatial.distance(tquat, tquat).shape == (*leading, 2)
    assert spatial.tquat_to_xyzrpy(tquat).shape == (*leading, 6)
    assert spatial.tquat_to_matrix(tquat).shape == (*leading, 4, 4)
    assert spatial.xyzw_to_wxyz(tquat[..., 3:]).shape == (*leading, 4)
    assert spatial.limit_step(tquat, tquat, 0.1, 0.1).shape == (*leading, 7)


@pytest.mark.parametrize("batch", [(1,), (0,), (3,), (2, 3)])
@pytest.mark.parametrize("lone", [(), (1,)])
def test_a_single_pose_serves_every_row_of_a_batch(batch: tuple[int, ...], lone: tuple[int, ...]) -> None:
    one = random_tquats(*lone, seed=1)
    many = random_tquats(*batch, seed=2)
    spread = np.broadcast_to(one, many.shape)
    np.testing.assert_array_equal(spatial.compose(one, many), spatial.compose(spread, many))
    np.testing.assert_array_equal(spatial.compose(many, one), spatial.compose(many, spread))


@pytest.mark.parametrize(("first", "second"), [((2,), (3,)), ((0,), (3,)), ((2, 3), (3,)), ((1, 1), (3,))])
def test_leading_shapes_that_do_not_fit_are_refused(first: tuple[int, ...], second: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="equal leading shapes"):
        spatial.compose(random_tquats(*first), random_tquats(*second))


def test_relative_undoes_compose() -> None:
    np.testing.assert_allclose(spatial.relative(A, spatial.compose(A, B)), B, atol=1e-13)


def test_conversions_give_the_poses_back() -> None:
    np.testing.assert_allclose(spatial.xyzrpy_to_tquat(spatial.tquat_to_xyzrpy(A)), A, atol=1e-14)
    np.testing.assert_allclose(spatial.matrix_to_tquat(spatial.tquat_to_matrix(A)), A, atol=1e-14)
    np.testing.assert_array_equal(spatial.wxyz_to_xyzw(spatial.xyzw_to_wxyz(A[:, 3:])), A[:, 3:])


def test_wxyz_has_the_scalar_first() -> None:
    np.testing.assert_array_equal(spatial.wxyz_to_xyzw((1.0, 2.0, 3.0, 4.0)), (2.0, 3.0, 4.0, 1.0))
    np.testing.assert_array_equal(spatial.xyzw_to_wxyz((2.0, 3.0, 4.0, 1.0)), (1.0, 2.0, 3.0, 4.0))


def test_matrices_turn_points_as_poses_do() -> None:
    points = np.append(np.arange(3.0), 1.0)
    for matrix, tquat in zip(spatial.tquat_to_matrix(A), A, strict=True):
        np.testing.assert_allclose((matrix @ points)[:3], Pose.from_tquat(tquat).apply(points[:3]), atol=1e-14)


def test_normalize_takes_any_length_and_gives_one_quaternion_per_rotation() -> None:
    scales = np.geomspace(1e-6, 1e200, 20)[:, None]
    stretched = np.concatenate([A[:, :3], -scales * A[:, 3:]], axis=1)
    np.testing.assert_allclose(spatial.normalize(stretched), A, atol=1e-14)


def test_normalize_leaves_a_normal_pose_as_it_is() -> None:
    np.testing.assert_array_equal(spatial.normalize(A), A)


def test_a_row_of_fractions_makes_a_path() -> None:
    path = spatial.interpolate(A[0], B[0], np.linspace(0, 1, 11))
    np.testing.assert_array_equal(path[[0, -1]], [A[0], B[0]])
    steps = spatial.distance(path[:-1], path[1:])
    np.testing.assert_allclose(steps, np.tile(spatial.distance(A[0], B[0]) / 10, (10, 1)), atol=1e-14)


@pytest.mark.parametrize("max_translation", [0.0, 0.05, math.inf])
@pytest.mark.parametrize("max_rotation", [0.0, 0.1, math.inf])
def test_a_limited_step_is_as_long_as_allowed_and_no_longer(max_translation: float, max_rotation: float) -> None:
    step = spatial.limit_step(A, B, max_translation, max_rotation)
    allowed = np.minimum(spatial.distance(A, B), (max_translation, max_rotation))
    np.testing.assert_allclose(spatial.distance(A, step), allowed, atol=1e-14)
    # What is left is shorter by the step: it leads towards the goal.
    np.testing.assert_allclose(spatial.distance(step, B), spatial.distance(A, B) - allowed, atol=1e-14)


def test_limited_steps_reach_the_goal_to_the_bit() -> None:
    pose = A
    for _ in range(200):
        pose = spatial.limit_step(pose, B, 0.1, 0.1)
    np.testing.assert_array_equal(pose, B)


def test_each_limit_clips_its_own_part() -> None:
    goal = Pose.from_rotvec((1, 0, 0), (0, 0, 0.05)).tquat
    step = Pose.from_tquat(spatial.limit_step(Pose().tquat, goal, 0.1, 0.1))
    assert step.is_close(Pose.from_rotvec((0.1, 0, 0), (0, 0, 0.05)), metres=1e-15, radians=1e-15)


def test_other_layouts_and_dtypes_give_the_same_numbers() -> None:
    expected = spatial.inverse(A)
    np.testing.assert_array_equal(spatial.inverse(np.asfortranarray(A)), expected)
    np.testing.assert_array_equal(spatial.inverse(np.repeat(A, 2, axis=0)[::2]), expected)
    np.testing.assert_array_equal(spatial.inverse(A.tolist()), expected)
    np.testing.assert_array_equal(spatial.inverse(A.astype(">f8")), expected)
    np.testing.assert_allclose(spatial.inverse(A.astype(np.float32)), expected, atol=1e-6)


def test_arguments_are_not_changed_and_results_are_new() -> None:
    before = A.copy()
    result = spatial.normalize(A)
    result[:] = 0.0
    np.testing.assert_array_equal(A, before)
    before.flags.writeable = False
    np.testing.assert_array_equal(spatial.normalize(before), A)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: spatial.compose(A, np.zeros(6)), r"b must have the shape \(..., 7\), got \(6,\)"),
        (lambda: spatial.inverse(1.0), r"a must have the shape \(..., 7\), got \(\)"),
        (lambda: spatial.inverse([*A[:3], np.zeros(7)]), "row 3: quaternion .* must have norm 1"),
        (lambda: spatial.tquat_to_matrix(np.full(7, np.nan)), "translation must be 3 finite numbers"),
        (lambda: spatial.matrix_to_tquat(np.zeros((4, 4))), "matrix must be a rotation"),
        (lambda: spatial.xyzrpy_to_tquat((0, 0, 0, math.inf, 0, 0)), "rpy must be 3 finite numbers"),
        (lambda: spatial.normalize(np.zeros(7)), "quaternion must not be zero"),
        (lambda: spatial.normalize((0, 0, 0, 0, 0, 0, math.nan)), "quaternion must be 4 finite numbers"),
        (lambda: spatial.interpolate(A[0], B[0], (0.0, 1.1)), r"row 1: fraction must be in \[0, 1\], got 1.1"),
        (lambda: spatial.limit_step(A, B, -0.1, 1.0), "limits of a step must be 0 or more"),
        (lambda: spatial.limit_step(A, B, 0.1, math.nan), "limits of a step must be 0 or more"),
    ],
)
def test_bad_input_is_refused_with_what_came_and_what_is_valid(call: Callable[[], Floats], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
