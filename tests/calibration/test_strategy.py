"""The board strategy goes where the board is in view, inside the limits, and where the next view tells most."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.calibration import BoardStrategy, Rig
from rcs.calibration.fit import Guess, Sightings
from rcs.calibration.motion import motions
from rcs.calibration.strategy import FROM_LIMITS, is_in_view, suggest
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.spatial import Intrinsics, Pose

pytestmark = pytest.mark.extras

HOME = np.array(FR3.home)


def rig_of(lens: Intrinsics, camera: Pose, board: Pose | None) -> Rig:
    return Rig(
        kinematics=kinematics_of(FR3),
        arrangement="eye-in-hand",
        intrinsics=lens,
        camera_in_mount=camera,
        board_in_anchor=board,
    )


@pytest.fixture
def ahead(lens: Intrinsics) -> Rig:
    """A camera along the flange's axis, and a board below it at home, facing up."""
    camera = Pose([0.05, 0.0, 0.03])
    below = kinematics_of(FR3).forward(HOME) * camera * Pose.from_rotvec([0.0, 0.0, 0.4], [np.pi, 0.0, 0.0])
    return rig_of(lens, camera, below)


def test_suggested_joints_have_the_board_in_view_and_keep_from_the_limits(
    ahead: Rig, lens: Intrinsics, seen: Callable[..., Any]
) -> None:
    assert ahead.board_in_anchor is not None
    board = seen("eye-in-hand", views=1).board
    guess = Guess(ahead.camera_in_mount, ahead.board_in_anchor)
    nothing = Sightings.of(board, [], "eye-in-hand", lens)
    for seed in range(5):
        joints = suggest(ahead, board, guess, nothing, [HOME], rng=np.random.default_rng(seed))
        assert joints is not None
        assert (joints >= ahead.kinematics.joint_lower + FROM_LIMITS).all()
        assert (joints <= ahead.kinematics.joint_upper - FROM_LIMITS).all()
        anchor = ahead.kinematics.forward(joints).inverse().matrix
        assert is_in_view(guess.boards_in_camera(anchor[None]), board, lens)[0]


def test_only_free_ways_are_suggested(ahead: Rig, lens: Intrinsics, seen: Callable[..., Any]) -> None:
    strategy = BoardStrategy(ahead, seen("eye-in-hand", views=1).board)
    asked: list[NDArray[np.float64]] = []

    def third(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        np.testing.assert_array_equal(start, HOME)
        asked.append(end)
        return len(asked) == 3

    joints = strategy.next_joints(HOME, third)
    assert joints is not None and len(asked) == 3
    np.testing.assert_array_equal(joints, asked[-1])
    with pytest.raises(InvalidSetup, match="No pose was found"):
        strategy.next_joints(HOME, lambda start, end: False)


def test_without_a_view_and_without_a_guess_a_person_is_asked(lens: Intrinsics, seen: Callable[..., Any]) -> None:
    strategy = BoardStrategy(rig_of(lens, Pose(), None), seen("eye-in-hand", views=1).board)
    assert not strategy.look(np.full((480, 640, 3), 90, np.uint8), HOME)
    with pytest.raises(InvalidSetup, match="Move the arm until the camera sees the whole board"):
        strategy.next_joints(HOME)


def test_a_strategy_gives_up_when_it_sees_nothing_for_long(ahead: Rig, seen: Callable[..., Any]) -> None:
    strategy = BoardStrategy(ahead, seen("eye-in-hand", views=1).board, views=2)
    for _ in range(6):
        strategy.look(np.full((480, 640), 90, np.uint8), HOME)
    with pytest.raises(InvalidSetup, match="0 of 6 pictures"):
        strategy.next_joints(HOME)


@pytest.mark.parametrize(
    ("offset", "is_seen"),
    [
        (Pose([0, 0, 0.4]), True),
        (Pose([0, 0, -0.4]), False),
        (Pose([0.3, 0, 0.4]), False),
        (Pose([0, 0, 6.0]), False),
        (Pose.from_rotvec([0, 0, 0.4], [1.2, 0, 0]), False),
    ],
    ids=["before it", "behind it", "beside it", "too far", "too slanted"],
)
def test_a_board_is_in_view_if_it_is_whole_large_and_facing(
    offset: Pose, is_seen: bool, lens: Intrinsics, seen: Callable[..., Any]
) -> None:
    pose = (offset * Pose.from_rotvec([0, 0, 0], [np.pi, 0, 0])).matrix
    assert is_in_view(pose[None], seen("eye-in-hand", views=1).board, lens)[0] == is_seen


def test_motions_are_the_same_in_any_frame() -> None:
    rng = np.random.default_rng(0)
    poses = [Pose.from_rotvec(rng.normal(0, 0.1, 3), rng.normal(0, 0.3, 3)) for _ in range(12)]
    other = Pose.from_rotvec([1.0, 2.0, 3.0], [0.3, -1.0, 2.0])
    a, b = motions(poses), motions([other * pose for pose in poses])
    np.testing.assert_allclose(a.spread, b.spread, atol=1e-9)
    assert a.largest_turn == pytest.approx(b.largest_turn) and a.lacks == b.lacks == []
