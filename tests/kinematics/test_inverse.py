from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import DampedLeastSquares, IkOptions, IkResult, IkStatus, Kinematics, kinematics_of
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import Pose, distance

HOME = np.array(FR3.home)
FAR = Pose([2.0, 0.0, 0.5])


def test_at_least_99_percent_of_reachable_poses_are_solved_inside_the_limits(
    solver: DampedLeastSquares, random_joints: NDArray[np.float64]
) -> None:
    targets = solver.forward_batch(random_joints)
    starts = np.tile(HOME, (len(targets), 1))
    joints, status, errors = solver.inverse_batch(targets, starts, IkOptions())
    is_solved = status == IkStatus.ok.value
    assert is_solved.mean() >= 0.99
    assert (joints >= solver.joint_lower).all()
    assert (joints <= solver.joint_upper).all()
    miss = distance(solver.forward_batch(joints), targets)[is_solved]
    np.testing.assert_allclose(errors[is_solved], miss, atol=1e-7)
    assert miss[:, 0].max() <= 1e-4
    assert miss[:, 1].max() <= 2e-4


def test_a_pose_near_the_start_is_solved_near_the_start(solver: DampedLeastSquares) -> None:
    rng = np.random.default_rng(2)
    for offset in rng.uniform(-0.05, 0.05, (50, 7)):
        target = solver.forward(HOME + offset)
        result = solver.inverse(target, HOME, IkOptions(restarts=0))
        assert result.status is IkStatus.ok
        assert np.abs(result.joints - HOME).max() < 0.3


def test_the_pose_of_the_start_needs_no_iteration_and_gives_the_start(solver: DampedLeastSquares) -> None:
    result = solver.inverse(solver.forward(HOME), HOME)
    assert result.status is IkStatus.ok
    assert result.iterations == 0
    np.testing.assert_array_equal(result.joints, HOME)


@pytest.mark.parametrize("fraction", [0.01, 0.5, 0.99])
def test_a_solution_farther_away_than_allowed_is_clamped_towards(solver: DampedLeastSquares, fraction: float) -> None:
    target = solver.forward(HOME + np.array([0.9, 0.1, 0.0, 0.1, 0.0, 0.1, 0.0]))
    free = solver.inverse(target, HOME)
    assert free.status is IkStatus.ok
    whole = free.joints - HOME
    max_step = fraction * float(np.abs(whole).max())
    clamped = solver.inverse(target, HOME, IkOptions(max_step=np.full(7, max_step)))
    assert clamped.status is IkStatus.clamped
    np.testing.assert_allclose(clamped.joints - HOME, fraction * whole, atol=1e-12)


def test_a_pose_out_of_reach_gives_the_start(solver: DampedLeastSquares) -> None:
    result = solver.inverse(FAR, HOME)
    assert result.status is IkStatus.infeasible
    np.testing.assert_array_equal(result.joints, HOME)
    assert result.translation_error > 0.5


@pytest.mark.parametrize("is_followed", [False, True])
@pytest.mark.parametrize("threads", [1, 2, 7])
def test_a_batch_is_a_loop_at_any_number_of_threads(
    solver: DampedLeastSquares, random_joints: NDArray[np.float64], threads: int, is_followed: bool
) -> None:
    targets = solver.forward_batch(random_joints[:40])
    targets[3] = FAR.tquat
    starts = np.tile(HOME, (40, 1))
    options = IkOptions(restarts=3, max_step=np.full(7, 1.0), best_effort=is_followed, preferred=HOME)
    joints, status, errors = solver.inverse_batch(targets, starts, options, threads=threads)
    for i, target in enumerate(targets):
        one = solver.inverse(Pose(target[:3], target[3:]), starts[i], options)
        np.testing.assert_array_equal(joints[i], one.joints)
        assert status[i] == one.status.value
        np.testing.assert_array_equal(errors[i], [one.translation_error, one.rotation_error])


@pytest.mark.parametrize(
    "translation", [[1e300, 0, 0], [1e9, -1e9, 1e9], [1e-300, 0, 0], [0.0, 0.0, 0.0], [0, 0, -0.5], [0, 0, 1e154]]
)
@pytest.mark.parametrize("quaternion", [[1, 0, 0, 0], [0, 0, 0, 1], [0.5, 0.5, 0.5, 0.5]])
def test_absurd_poses_never_give_a_number_that_is_not_finite(
    solver: DampedLeastSquares, translation: list[float], quaternion: list[float]
) -> None:
    result = solver.inverse(Pose(translation, quaternion), HOME, IkOptions(restarts=2))
    assert np.isfinite(result.joints).all()
    assert (result.joints >= solver.joint_lower).all()
    assert (result.joints <= solver.joint_upper).all()
    if result.status is IkStatus.infeasible:
        np.testing.assert_array_equal(result.joints, HOME)


def test_a_start_outside_the_limits_is_moved_inside(solver: DampedLeastSquares) -> None:
    result = solver.inverse(FAR, np.full(7, 50.0))
    np.testing.assert_array_equal(result.joints, solver.joint_upper)


@pytest.mark.parametrize("backend", ["mujoco", pytest.param("pinocchio", marks=pytest.mark.extras)])
def test_a_joint_that_is_followed_from_outside_its_limits_stays_or_comes_back(backend: Any) -> None:
    solver = kinematics_of(FR3, FRANKA_HAND, backend=backend)
    start = HOME.copy()
    start[3] = solver.joint_upper[3] + 0.1
    here = solver.forward(start)
    options = IkOptions(best_effort=True, max_step=np.full(7, 0.1), preferred=HOME)
    stays = solver.inverse(here, start, options)
    assert stays.status is IkStatus.ok
    np.testing.assert_array_equal(stays.joints, start)
    for shift in np.vstack([np.eye(3), -np.eye(3)]) * 0.05:
        moved = Pose(here.translation + shift, here.quaternion)
        joints = solver.inverse(moved, start, options).joints
        assert np.abs(joints - start).max() > 0.01
        assert joints[3] <= start[3]
        assert (np.delete(joints, 3) <= np.delete(solver.joint_upper, 3)).all()


def test_same_seed_same_answer(solver: DampedLeastSquares, random_joints: NDArray[np.float64]) -> None:
    target = solver.forward(random_joints[5])
    answers = [solver.inverse(target, HOME, IkOptions(seed=3, iterations=8)).joints for _ in range(2)]
    np.testing.assert_array_equal(*answers)


def test_poses_and_starts_that_make_no_sense_are_refused(solver: DampedLeastSquares) -> None:
    target = solver.forward(HOME)
    for start in (HOME[1:], np.full(7, np.nan)):
        with pytest.raises(InvalidSetup):
            solver.inverse(target, start)
    rows, starts = np.tile(target.tquat, (3, 1)), np.tile(HOME, (3, 1))
    for bad_rows, bad_starts in ((rows[:, :6], starts), (rows[:2], starts), (rows, starts[:, :6])):
        with pytest.raises(InvalidSetup):
            solver.inverse_batch(bad_rows, bad_starts)
    with pytest.raises(InvalidSetup, match="not finite"):
        solver.inverse_batch(rows, np.full((3, 7), np.nan))
    with pytest.raises(ValueError, match="finite"):
        solver.inverse_batch(np.full((3, 7), np.nan), starts)


@pytest.mark.parametrize(
    "option",
    [
        {"iterations": 0},
        {"restarts": -1},
        {"damping": 0.0},
        {"max_step": np.array([0.1, 0.0])},
        {"max_step": np.array([np.nan])},
        {"preferred": np.array([np.inf])},
        {"preferred_weight": -1.0},
        {"translation_tolerance": 0.0},
        {"rotation_tolerance": -1.0},
        {"damping": float("nan")},
    ],
)
def test_options_that_make_no_sense_are_refused(option: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup, match="IkOptions"):
        IkOptions(**option)


@pytest.mark.parametrize("option", [{"max_step": np.ones(1)}, {"preferred": np.zeros(8)}])
def test_options_for_another_number_of_joints_are_refused(solver: DampedLeastSquares, option: dict[str, Any]) -> None:
    for call in (
        solver.inverse,
        lambda target, start, options: solver.inverse_batch(target.tquat[None], start[None], options),
    ):
        with pytest.raises(InvalidSetup, match="one entry for each of the 7 joints"):
            call(solver.forward(HOME), HOME, IkOptions(**option))


class Gantry(Kinematics):
    """Kinematics in Python: three joints that are the translation."""

    def _dof(self) -> int:
        return 3

    def _joint_lower(self) -> list[float]:
        return [-1.0, -1.0, 0.0]

    def _joint_upper(self) -> list[float]:
        return [1.0, 1.0, 2.0]

    def _forward(self, joints: NDArray[np.float64]) -> Pose:
        return Pose(joints)

    def _inverse(self, target: Pose, start: NDArray[np.float64], options: IkOptions) -> IkResult:
        return IkResult(list(target.translation), IkStatus.ok, iterations=options.iterations)


def test_kinematics_can_be_written_in_python() -> None:
    gantry = Gantry()
    target = gantry.forward(np.array([0.1, 0.2, 0.3]))
    result = gantry.inverse(target, np.zeros(3), IkOptions(iterations=9))
    assert gantry.dof == 3
    assert result.iterations == 9
    np.testing.assert_array_equal(result.joints, [0.1, 0.2, 0.3])


def test_kinematics_written_in_python_have_batches_and_a_jacobian() -> None:
    gantry = Gantry()
    joints = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    poses = gantry.forward_batch(joints)
    np.testing.assert_array_equal(poses[:, :3], joints)
    solved, status, _ = gantry.inverse_batch(poses, np.zeros((5, 3)), threads=4)
    np.testing.assert_array_equal(solved, joints)
    assert (status == IkStatus.ok.value).all()
    np.testing.assert_allclose(gantry.jacobian(joints[0]), np.eye(6, 3), atol=1e-9)
    np.testing.assert_array_equal(gantry.joint_lower, [-1, -1, 0])
    np.testing.assert_array_equal(gantry.joint_upper, [1, 1, 2])


def test_a_batch_of_the_wrong_shape_is_refused_also_by_kinematics_in_python() -> None:
    with pytest.raises(InvalidSetup, match=r"\(N, 3\)"):
        Gantry().forward_batch(np.zeros((2, 4)))
    with pytest.raises(InvalidSetup, match=r"\(N, 3\)"):
        Gantry().inverse_batch(np.zeros((2, 7)), np.zeros((2, 4)))


class Numeric(Kinematics):
    """The forward kinematics of a solver, and nothing else of it."""

    def __init__(self, solver: DampedLeastSquares) -> None:
        super().__init__()
        self._solver = solver

    def _dof(self) -> int:
        return self._solver.dof

    def _forward(self, joints: NDArray[np.float64]) -> Pose:
        return self._solver.forward(joints)


def test_a_jacobian_that_nobody_wrote_is_the_derivative_of_the_pose(
    solver: DampedLeastSquares, random_joints: NDArray[np.float64]
) -> None:
    numeric = Numeric(solver)
    for joints in random_joints[:20]:
        np.testing.assert_allclose(numeric.jacobian(joints), solver.jacobian(joints), atol=1e-6)


class Short(Gantry):
    """Kinematics whose answer has a joint too few."""

    def _inverse(self, target: Pose, start: NDArray[np.float64], options: IkOptions) -> IkResult:
        return IkResult([0.0, 0.0], IkStatus.ok)


def test_an_answer_with_a_wrong_number_of_joints_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="wrong number of joints"):
        Short().inverse_batch(np.array([[0, 0, 0, 0, 0, 0, 1.0]]), np.zeros((1, 3)))


def test_a_solver_takes_a_model_and_no_address() -> None:
    for bad in (0, None, "model"):
        with pytest.raises(TypeError):
            DampedLeastSquares(bad, [0], 0, 0)  # pyright: ignore[reportArgumentType]


class Bent(Gantry):
    """Kinematics whose author returns the wrong things."""

    def _dof(self) -> int:
        return "three"  # pyright: ignore[reportReturnType]

    def _forward(self, joints: NDArray[np.float64]) -> Pose:
        return [0.0, 0.0, 0.0]  # pyright: ignore[reportReturnType]

    def _inverse(self, target: Pose, start: NDArray[np.float64], options: IkOptions) -> IkResult:
        return None  # pyright: ignore[reportReturnType]


def test_a_wrong_return_type_of_kinematics_in_python_is_named() -> None:
    bent = Bent()
    with pytest.raises(TypeError, match=r"Bent\._dof returned 'three' of type str, it must return an int"):
        _ = bent.dof
    with pytest.raises(TypeError, match=r"Bent\._forward returned .* of type list, it must return a Pose"):
        bent.forward(np.zeros(3))
    with pytest.raises(TypeError, match=r"Bent\._inverse returned None of type NoneType, it must return an IkResult"):
        bent.inverse(Pose(), np.zeros(3))


def test_one_solver_answers_many_threads_as_it_answers_one(
    solver: DampedLeastSquares, random_joints: NDArray[np.float64]
) -> None:
    targets = solver.forward_batch(random_joints)
    starts = np.tile(HOME, (len(targets), 1))
    expected = solver.inverse_batch(targets, starts)[0]
    with ThreadPoolExecutor(4) as pool:
        answers = [pool.submit(solver.inverse_batch, targets, starts, threads=1 + i % 2) for i in range(8)]
    for answer in answers:
        np.testing.assert_array_equal(answer.result()[0], expected)
