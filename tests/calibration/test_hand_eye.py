"""A camera is found where it is, whatever a tenth of the tags say, and a set that cannot tell is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from rcs.calibration import Arrangement, Board, Detections, HandEye, Rig, View, hand_eye, verify
from rcs.calibration.fit import GIVEN, Guess, Sightings, jacobian, residuals
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.fr3.description import FR3
from rcs.spatial import Intrinsics, Pose

pytestmark = pytest.mark.extras

ARRANGEMENTS = get_args(Arrangement)


def off(found: HandEye, true: Pose) -> tuple[float, float]:
    step = true.inverse() * found.camera_in_mount
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


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_with_noise_of_pictures_and_robot_the_error_is_small_and_as_large_as_is_said(
    arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    ratios = []
    for seed in range(5):
        one = seen(arrangement, noise=0.1, robot=(1e-4, np.deg2rad(0.02)), seed=seed)
        found = hand_eye(one.board, one.views, arrangement, lens)
        millimetres, degrees = off(found, one.camera)
        assert millimetres < 1.0 and degrees < 0.15
        ratios.append((millimetres / found.sigma_mm, degrees / found.sigma_degrees))
    middle = np.median(ratios, axis=0)
    assert (middle > 0.2).all() and (middle < 3.0).all(), "the covariance tells the size of the error"


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
    one = seen(arrangement, noise=0.1, robot=(1e-4, np.deg2rad(0.02)))
    wrong = replace(lens, fx=factor * lens.fx, fy=factor * lens.fy)
    assert not hand_eye(one.board, one.views, arrangement, lens).alarms
    found = hand_eye(one.board, one.views, arrangement, wrong)
    assert "focal lengths" in found.alarms[0]
    assert 1 + found.focal_off == pytest.approx(1 / factor, abs=2e-3)


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
    assert hand_eye(Board(tag_size=0.0784, gap=0.0196), one.views, "eye-in-hand", lens).alarms


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
