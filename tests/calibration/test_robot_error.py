"""How far a robot is off in its views is found with the poses, and the poses are better for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from rcs.calibration import Arrangement
from rcs.calibration.fit import Guess, Sightings, fit_with_robot, flange_jacobian, moved_by, residuals
from rcs.spatial import Intrinsics, Pose

pytestmark = pytest.mark.extras

ARRANGEMENTS = get_args(Arrangement)
LARGE = (5e-4, np.deg2rad(0.1))


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_the_jacobian_of_the_flange_is_that_of_views_with_another_flange(
    arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen(arrangement, views=3)
    step = 1e-4 * np.random.default_rng(0).standard_normal(6)
    turned = [replace(view, flange_in_base=view.flange_in_base * Pose.exp(step)) for view in one.views]
    before, after = (Sightings.of(one.board, views, arrangement, lens) for views in (one.views, turned))
    guess = Guess(one.camera, one.place)
    change = (residuals(guess, after) - residuals(guess, before)).ravel()
    np.testing.assert_allclose(flange_jacobian(guess, before) @ step, change, atol=2e-4)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize("robot", [(0.0, 0.0), (1e-4, np.deg2rad(0.02)), LARGE])
def test_what_the_robot_is_off_is_found(
    robot: tuple[float, float], arrangement: Arrangement, seen: Callable[..., Any], lens: Intrinsics
) -> None:
    one = seen(arrangement, noise=0.05, robot=robot, views=40)
    fit = fit_with_robot(Guess(one.camera, one.place), Sightings.of(one.board, one.views, arrangement, lens))
    np.testing.assert_allclose(fit.robot, robot, rtol=0.25, atol=4e-5)
    # Two coordinates of 0.05 px each, whatever the robot does; it may explain 6 of the 32 in a view.
    assert 0.9 * np.sqrt(26 / 32) < np.sqrt(np.mean(fit.tag_errors**2)) / (0.05 * np.sqrt(2)) < 1.1


def test_without_a_view_the_guess_is_that_of_the_others(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand", robot=LARGE)
    every = Sightings.of(one.board, one.views, "eye-in-hand", lens)
    start = Guess(one.camera, one.place)
    fit = fit_with_robot(start, every, LARGE)
    assert fit.robot == pytest.approx(LARGE, rel=1e-9) and len(fit.without) == len(one.views)
    for view in (0, 7):
        alone = fit_with_robot(start, every[every.view != view], LARGE).guess
        away = np.linalg.norm(moved_by(fit.guess.camera, alone.camera))
        assert np.linalg.norm(moved_by(fit.without[view].camera, alone.camera)) < 0.1 * away


def test_the_covariance_is_that_of_many_tries(seen: Callable[..., Any], lens: Intrinsics) -> None:
    tries = [seen("eye-to-hand", robot=LARGE, views=12, seed=seed) for seed in range(15)]
    ratios = []
    for one in tries:
        fit = fit_with_robot(Guess(one.camera, one.place), Sightings.of(one.board, one.views, "eye-to-hand", lens))
        off = moved_by(one.camera, fit.guess.camera)
        ratios.append(off @ np.linalg.solve(fit.covariance[:6, :6], off))
    assert 3.0 < np.mean(ratios) < 12.0, "squares of six numbers of size one"
