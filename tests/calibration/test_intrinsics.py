"""Focal lengths, principal point and distortion are found from pictures that can tell, and only from those."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rcs.calibration import Board, Detections, fit_intrinsics
from rcs.calibration.board_pose import project
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, Pose, distort

pytestmark = pytest.mark.extras


def pictures(
    lens: Intrinsics,
    *,
    count: int = 25,
    tilt: float = 0.5,
    spread: float = 1.0,
    depths: tuple[float, float] = (0.3, 0.6),
    noise: float = 0.05,
    seed: int = 0,
) -> list[Detections]:
    """Return what a camera sees of a board that is tilted by up to `tilt` and anywhere in a share of the picture."""
    rng = np.random.default_rng(seed)
    board, found = Board(), list[Detections]()
    while len(found) < count:
        depth = rng.uniform(*depths)
        across = spread * rng.uniform(-0.7, 0.7, 2) * (1.0, 0.75) * depth
        tilted = Pose.from_rotvec([*across, depth], [np.pi, 0, 0]) * Pose.from_rpy(
            [0, 0, 0], [*rng.uniform(-tilt, tilt, 2), rng.uniform(-3, 3)]
        )
        rays = project(tilted.matrix, board.corners)
        pixels = distort(rays, lens.distortion) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        is_inside = ((pixels > 2) & (pixels < [lens.width - 3, lens.height - 3])).all(axis=(1, 2))
        if is_inside.sum() >= 3:
            pixels = pixels + rng.normal(0, noise, pixels.shape)
            found.append(Detections(np.array(board.ids)[is_inside], pixels[is_inside]))
    return found


def test_the_lens_is_found(lens: Intrinsics) -> None:
    fit = fit_intrinsics(Board(), pictures(lens), (640, 480))
    found = fit.intrinsics
    for name, sigma in zip(("fx", "fy", "cx", "cy"), fit.sigma, strict=True):
        assert abs(getattr(found, name) - getattr(lens, name)) < 5 * sigma < 3.0
    np.testing.assert_allclose(found.distortion, lens.distortion, atol=0.02)
    assert fit.held_out_px < 0.1


def test_wrong_tags_change_nothing_to_speak_of(lens: Intrinsics) -> None:
    right = pictures(lens)
    wrong = [Detections(one.ids, one.corners.copy()) for one in right]
    for one in wrong[::3]:
        one.corners[0] += (9.0, -5.0)
    fit = fit_intrinsics(Board(), wrong, (640, 480))
    assert fit.rejected >= len(wrong[::3])
    assert fit.intrinsics.fx == pytest.approx(lens.fx, rel=2e-3)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"count": 4}, "too few: add 4"),
        ({"tilt": 0.02}, "never tilted"),
        ({"spread": 0.1, "depths": (0.8, 1.0)}, "of the picture's parts: add pictures"),
    ],
)
def test_pictures_that_cannot_tell_are_refused_with_what_is_missing(
    options: dict[str, Any], text: str, lens: Intrinsics
) -> None:
    with pytest.raises(InvalidSetup, match=text):
        fit_intrinsics(Board(), pictures(lens, **options), (640, 480))


def test_the_views_of_a_hand_eye_calibration_will_do(seen: Callable[..., Any], lens: Intrinsics) -> None:
    one = seen("eye-in-hand", views=30)
    fit = fit_intrinsics(one.board, [view.detections for view in one.views], (640, 480))
    assert fit.intrinsics.fx == pytest.approx(lens.fx, rel=3e-3)
