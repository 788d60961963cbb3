"""A camera is found where it is, whatever a tenth of the tags say, and a set that cannot tell is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from rcs.calibration import Arrangement, Board, Detections, HandEye, Rig, View, hand_eye, verify
from rcs.calibration.board_pose import board_poses
from rcs.calibration.closed_form import camera_in_mount, rigid
from rcs.calibration.fit import GIVEN, Guess, Sightings, jacobian, residuals
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.spatial import Intrinsics, Pose

pytestmark = pytest.mark.extras

ARRANGEMENTS = get_args(Arrangement)


SMALL, LARGE = (1e-4, np.deg2rad(0.02)), (5e-4, np.deg2rad(0.1))


def off(found: HandEye, true: Pose) -> tuple[float, float]:
    return away(found.camera_in_mount, true)


def away(found: Pose, true: Pose) -> tuple[float, float]:
    step = true.inverse() * found
    return 1000 * float(np.linalg.norm(step.translation)), float(np.rad2deg(np.linalg.norm(step.rotvec)))


def spoilt(views: list[View], share: float, seed: int = 0) -> tuple[list[View], set[tuple[int, int]]]:
    """Return views with some tags moved, turned round, or in each other's place, and which."""
    rng = np.random.default_rng(seed)
    tags = [(i, k) for i, view in enumerate(views) for k in range(len(view.detections))]
    wrong = [tags[n] for n in rng.choice(len(tags), round(share * len(tags)), replace=False)]
    corners = [view.detections.corners.copy() for view in views]
    for n, (i, k) in enumerate(wrong):
        own = corners[i]
        if n % 3 == 0:
            own[k] += rng.uniform(8, 40, 2)
        elif n % 3 == 1:
            own[k] = own[k][[2, 3, 0, 1]]
        else:
            own[k] = own[(k + 1) % len(own)] + rng.normal(0, 3, (4, 2))
    made = [
        replace(view, detections=Detections(view.detections.ids, own)) for view, own in zip(views, corners, strict=True)
    ]
    return made, set(wrong)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_without_noise_the_pose_is_exact(arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen(arrangement, noise=0.0)
    found = hand_eye(one.board, one.views, arrangement, lens)
    millimetres, degrees = off(found, one.camera)
    assert millimetres < 1e-4 and degrees < 1e-5 and found.residual_px < 1e-5
    np.testing.assert_allclose(found.board_in_anchor.matrix, one.place.matrix, atol=1e-7)
    assert not found.alarms and not found.rejected


def rms(errors: list[tuple[float, float]]) -> np.ndarray[Any, Any]:
    return np.sqrt(np.mean(np.square(errors), axis=0))


def park(one: Any, lens: Intrinsics) -> tuple[float, float]:
    """Return the error of Park's closed form."""
    anchors = np.array([view.anchor_in_mount(one.arrangement) for view in one.views])
    boards = [board_poses(one.board, view.detections, lens)[0].board_in_camera for view in one.views]
    return away(rigid(camera_in_mount(anchors, np.array(boards))), one.camera)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize(("robot", "limit"), [(SMALL, 0.3), (LARGE, 0.8)], ids=["small", "large"])
def test_with_a_robot_that_is_off_the_error_is_small_and_as_large_as_is_said(
    robot: tuple[float, float], limit: float, arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    errors, closed, ratios = [], [], []
    for seed in range(4):
        one = seen(arrangement, noise=0.1, robot=robot, seed=seed)
        found = hand_eye(one.board, one.views, arrangement, lens)
        errors.append(off(found, one.camera))
        closed.append(park(one, lens))
        ratios.append((errors[-1][0] / found.sigma_mm, errors[-1][1] / found.sigma_degrees))
        assert not found.alarms
    assert np.median(errors, axis=0)[0] < limit
    assert (rms(errors) < rms(closed)).all(), "better than Park's closed form"
    middle = np.median(ratios, axis=0)
    assert (middle > 0.4).all() and (middle < 1.6).all(), "the covariance tells the size of the error"


def test_a_robot_that_is_said_to_be_three_times_as_far_off_still_helps(
    seen: Callable[..., Any], lens: Intrinsics
) -> None:
    thrice = (3 * SMALL[0], 3 * SMALL[1])
    views = [seen("eye-in-hand", noise=0.1, robot=SMALL, seed=seed) for seed in range(4)]
    found = [hand_eye(one.board, one.views, "eye-in-hand", lens, thrice) for one in views]
    assert found[0].robot == pytest.approx(thrice)
    errors = [off(result, one.camera) for result, one in zip(found, views, strict=True)]
    assert (rms(errors) < rms([park(one, lens) for one in views])).all()


@pytest.mark.parametrize("robot", [(-1e-4, 0.0), (1e-4, float("nan"))])
def test_a_robot_that_is_off_by_no_number_is_refused(
    robot: tuple[float, float], seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen("eye-in-hand")
    with pytest.raises(InvalidSetup, match="two standard deviations"):
        hand_eye(one.board, one.views, "eye-in-hand", lens, robot)


def test_a_wrong_tag_is_found_although_the_robot_is_off_by_more(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand", robot=LARGE)
    corners = one.views[3].detections.corners.copy()
    corners[1] += (2.5, -2.0)
    views = [*one.views]
    views[3] = replace(views[3], detections=Detections(views[3].detections.ids, corners))
    found = hand_eye(one.board, views, "eye-in-hand", lens)
    assert found.rejected == ((3, one.board.ids[1]),) and found.residual_px < 0.1


def test_a_robot_that_is_off_by_much_raises_the_alarm(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-to-hand", robot=(3e-3, np.deg2rad(0.02)))
    found = hand_eye(one.board, one.views, "eye-to-hand", lens)
    assert 2e-3 < found.robot[0] < 4e-3
    assert any("the robot seems to be off by" in alarm for alarm in found.alarms)
    assert "the robot seems to be off by" in str(found)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_a_tenth_of_wrong_tags_changes_nothing(
    arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen(arrangement)
    made, wrong = spoilt(one.views, 0.1)
    found = hand_eye(one.board, made, arrangement, lens)
    assert set(found.rejected) == {(i, one.board.ids[k]) for i, k in wrong}
    left = [
        replace(view, detections=view.detections[[k for k in range(4) if (i, k) not in wrong]])
        for i, view in enumerate(made)
    ]
    without = hand_eye(one.board, left, arrangement, lens)
    np.testing.assert_allclose(found.camera_in_mount.matrix, without.camera_in_mount.matrix, atol=1e-9)


def test_a_board_of_one_tag_that_looks_flipped_is_put_right(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand", noise=0.3)
    single = [replace(view, detections=view.detections[[0]]) for view in one.views]
    found = hand_eye(one.board, single, "eye-in-hand", lens)
    millimetres, degrees = off(found, one.camera)
    assert millimetres < 3.0 and degrees < 0.5


@pytest.mark.parametrize("axis", range(3))
def test_turns_about_one_axis_are_refused_with_the_axes_that_are_missing(
    axis: int, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen("eye-in-hand", turns=tuple(0.4 * (i == axis) for i in range(3)))
    with pytest.raises(InvalidSetup, match=r"one axis only.*add poses that are turned by 20 to 40 degrees about"):
        hand_eye(one.board, one.views, "eye-in-hand", lens)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"turns": (0.0, 0.0, 0.0)}, "only moves and never turns"),
        ({"turns": (0.05, 0.05, 0.05)}, "axis|too small"),
        ({"views": 5}, "5 views are too few: add 3"),
    ],
)
def test_other_poor_sets_are_refused_with_what_is_missing(
    options: dict[str, Any], text: str, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen("eye-in-hand", **options)
    with pytest.raises(InvalidSetup, match=text):
        hand_eye(one.board, one.views, "eye-in-hand", lens)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_focal_lengths_that_are_one_percent_off_raise_the_alarm(
    arrangement: Arrangement, factor: float, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen(arrangement, noise=0.1, robot=SMALL)
    wrong = replace(lens, fx=factor * lens.fx, fy=factor * lens.fy)
    assert not hand_eye(one.board, one.views, arrangement, lens).alarms
    found = hand_eye(one.board, one.views, arrangement, wrong)
    assert "focal lengths" in found.alarms[0]
    assert 1 + found.given_off[0] == pytest.approx(1 / factor, abs=2e-3)


def test_views_of_another_board_are_refused(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand")
    shuffled = [
        replace(view, flange_in_base=other.flange_in_base)
        for view, other in zip(one.views, [*one.views[7:], *one.views[:7]], strict=True)
    ]
    with pytest.raises(InvalidSetup, match="No pose of the camera explains"):
        hand_eye(one.board, shuffled, "eye-in-hand", lens)


def test_a_wrong_size_of_the_board_is_noticed(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand")
    found = hand_eye(Board(tag_size=0.0784, gap=0.0196), one.views, "eye-in-hand", lens)
    assert found.given_off[3] == pytest.approx(0.08 / 0.0784 - 1, abs=2e-3)
    assert any("a board that is 2" in alarm and "larger" in alarm for alarm in found.alarms)


def test_the_jacobian_is_that_of_finite_steps(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-to-hand", views=4)
    sightings = Sightings.of(one.board, one.views, "eye-to-hand", lens)
    guess = Guess(one.camera, one.place, np.zeros(GIVEN))
    step = 1e-4 * np.random.default_rng(0).standard_normal(12 + GIVEN)
    change = (residuals(guess.moved(step), sightings) - residuals(guess, sightings)).ravel()
    np.testing.assert_allclose(jacobian(guess, sightings) @ step, change, atol=2e-4)


def test_a_verification_tells_how_far_a_camera_was_moved(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand")
    rig = Rig(
        kinematics=kinematics_of(FR3),
        arrangement="eye-in-hand",
        intrinsics=lens,
        camera_in_mount=one.camera,
        board_in_anchor=one.place,
    )
    still = verify(rig, one.board, one.views)
    assert still.pixels < 0.2 and still.millimetres < 0.3
    moved = verify(replace(rig, camera_in_mount=one.camera * Pose([0.004, 0.0, 0.0])), one.board, one.views)
    assert moved.millimetres == pytest.approx(4.0, abs=0.2) and moved.pixels > 3.0
