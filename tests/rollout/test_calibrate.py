"""Cameras in simulation are found where they are, in both arrangements, and the arm touches nothing on the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.calibration import BoardStrategy, CalibrationStrategy, verify
from rcs.devices import ArmLimits
from rcs.devices.fakes import FakeArm
from rcs.errors import InvalidSetup, WrongOrder
from rcs.robots import FR3
from rcs.rollout import FreePath, Tour, look_around
from rcs.setups import Calibration, MountedCamera, ShowBoardOptions, board_setup, write_calibration
from rcs.spatial import Intrinsics

pytestmark = pytest.mark.extras


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "camera", "size"),
    [("fr3", "wrist", 0.08), ("fr3", "side", 0.08), ("so101", "wrist", 0.04), ("dual_fr3", "right_wrist", 0.08)],
)
def test_a_rendered_camera_is_found(robot: str, camera: str, size: float) -> None:
    from rcs.calibration import Board

    setup = board_setup(robot, camera, Board(tag_size=size, gap=size / 4))
    mounted, options = MountedCamera.of(setup, camera), ShowBoardOptions(**setup.task_options)
    refused: list[bool] = []
    with rcs.make(setup) as env:
        lens = Tour(env, robot=mounted.robot.name).intrinsics(camera)
        rig = mounted.rig(lens, options.mount.pose)
        strategy = BoardStrategy(rig, options.board, views=12)
        path = FreePath(env, mounted.robot.name)

        def is_free(start: Any, end: Any) -> bool:
            refused.append(not path(start, end))
            return not refused[-1]

        look_around(env, strategy, camera, is_free=is_free)
        found = strategy.solve()
    off = rig.camera_in_mount.inverse() * found.camera_in_mount
    assert 1000 * np.linalg.norm(off.translation) < 0.3
    assert np.rad2deg(np.linalg.norm(off.rotvec)) < 0.03
    assert not found.alarms
    assert verify(rig, options.board, strategy.views).pixels < 0.3
    again = mounted.calibration(found, lens)
    assert again.optical is not None
    np.testing.assert_allclose(again.optical.translation, mounted.camera.optical_in_parent.translation, atol=3e-4)
    place = mounted.known_board(found, options.board).mount.pose
    np.testing.assert_allclose(place.matrix, options.mount.pose.matrix, atol=1e-3)


@pytest.mark.gl
@pytest.mark.slow
def test_a_camera_with_a_bent_lens_is_found_and_its_lens_from_the_same_pictures(tmp_path: Path) -> None:
    bent = Intrinsics(width=640, height=480, fx=617.0, fy=612.0, cx=323.0, cy=236.0, distortion=(-0.3, 0, 0, 0, 0))
    about = Calibration(intrinsics=bent)
    write_calibration(tmp_path / "bent.json", {"side": about})
    setup = board_setup("fr3", "side", calibration=str(tmp_path / "bent.json"), image_size=(640, 480))
    mounted, options = MountedCamera.of(setup, "side"), ShowBoardOptions(**setup.task_options)
    rig = mounted.rig(bent, options.mount.pose)
    with rcs.make(setup) as env:
        strategy = BoardStrategy(rig, options.board, views=14)
        look_around(env, strategy, "side", is_free=FreePath(env, mounted.robot.name))
        found = strategy.solve()
    off = rig.camera_in_mount.inverse() * found.camera_in_mount
    assert 1000 * np.linalg.norm(off.translation) < 0.05 and not found.alarms
    # Nobody knew the lens when these were found; the fit straightens the pictures with what it finds first.
    strategy.views = strategy.views_through(replace(bent, distortion=()))
    fit = strategy.intrinsics().intrinsics
    assert abs(fit.fx - bent.fx) < 1.5 and fit.distortion[0] == pytest.approx(-0.3, abs=0.01)


def test_a_way_is_free_unless_the_arm_comes_near_something_on_it() -> None:
    with rcs.make(replace(board_setup("fr3", "wrist"), cameras=())) as env:
        home = env.reset(seed=0)[0]["joints"]
        path = FreePath(env, "fr3")
        turned, low = home.copy(), home.copy()
        turned[0] = 0.5
        low[1], low[3] = 0.9, -1.9  # the hand in the table
        assert path(home, home) and path(home, turned)
        assert not path(home, low)
        assert not path(home, home + 2 * (low - home)), "what is beyond it does not matter"
        assert path(low, low) and path(low, home), "away from what is near is free"
        assert not path(low, low + 0.2 * (low - home)), "nearer is not"


def test_environments_with_other_actions_are_refused() -> None:
    with rcs.make("Free", robot="fr3", control="tquat") as env, pytest.raises(InvalidSetup, match="absolute"):
        Tour(env)


def test_an_episode_that_ends_on_the_way_is_told() -> None:
    setup = replace(board_setup("fr3", "wrist"), cameras=(), max_episode_steps=2)
    with rcs.make(setup) as env:
        tour = Tour(env)
        with pytest.raises(WrongOrder, match="ended on the way"):  # the third step of two
            tour.go_to(tour.joints - 3.0 * np.eye(7)[6])


def test_a_camera_that_is_not_observed_is_told() -> None:
    with rcs.make("Free", robot="fr3", relative=False) as env, pytest.raises(InvalidSetup, match="cameras="):
        Tour(env).picture("wrist")


@pytest.mark.parametrize(
    ("camera", "robot", "text"),
    [("wrist", "left", "robot"), ("nowhere", None, "nowhere")],
)
def test_a_camera_or_robot_that_is_not_there_is_refused(camera: str, robot: str | None, text: str) -> None:
    setup = board_setup("fr3", "wrist")
    with pytest.raises(rcs.errors.UnknownName, match=text):
        MountedCamera.of(setup, camera, robot)


@pytest.mark.gl
@pytest.mark.slow
def test_in_real_time_pictures_count_only_when_the_arm_has_come_to_rest() -> None:
    setup = replace(board_setup("fr3", "wrist", image_size=(640, 480)), stepping="realtime")
    options = ShowBoardOptions(**setup.task_options)
    asked: list[bool] = []

    def confirm(start: Any, end: Any) -> bool:
        asked.append(len(asked) % 4 != 3)  # a person refuses some
        return asked[-1]

    twin = rcs.make(replace(setup, stepping="sync", cameras=()))
    twin.reset()
    env = rcs.make(setup, hardware={"fr3": "fake"})
    rig = MountedCamera.of(setup, "wrist").rig(Tour(env).intrinsics("wrist"), options.mount.pose)
    strategy = BoardStrategy(rig, options.board, views=9)
    look_around(env, strategy, "wrist", speed=1.5, is_free=FreePath(twin, "fr3"), confirm=confirm)
    found = strategy.solve()
    env.close()
    twin.close()
    off = rig.camera_in_mount.inverse() * found.camera_in_mount
    assert 1000 * np.linalg.norm(off.translation) < 0.5
    assert asked.count(True) >= 8 and False in asked


def test_a_slow_arm_has_the_time_that_its_way_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.rollout.calibrate.LONGEST", 1.5)
    with rcs.make("Free", robot="fr3", relative=False, hardware="fake", max_episode_steps=None) as env:
        tour = Tour(env, speed=0.2)
        target = tour.joints + 0.4 * np.eye(7)[6]
        tour.go_to(target)
        np.testing.assert_allclose(tour.joints, target, atol=3e-3)
        with pytest.raises(InvalidSetup, match="speed is 0"):
            Tour(env, speed=0)


def test_an_arm_that_came_to_rest_a_little_beyond_its_range_goes_on() -> None:
    limits = FR3.arm_limits
    start = np.array(FR3.home)
    start[5] = limits.joint_lower[5] - 4e-4
    arm = FakeArm(limits, start=start)
    with rcs.make("Free", robot="fr3", relative=False, hardware={"fr3": arm}, max_episode_steps=None) as env:
        tour = Tour(env, speed=0.5)
        target = start + [0.2, 0, 0, 0, 0, 4e-4, 0]
        tour.go_to(target)
        np.testing.assert_allclose(tour.joints, target, atol=3e-3)


class FirstFree(CalibrationStrategy):
    """Goes to the first of some joints to which it may go, and is done."""

    def __init__(self, *ways: Any) -> None:
        self.ways, self.gone = ways, list[Any]()

    def look(self, picture: Any, joints: Any) -> bool:
        return True

    def next_joints(self, joints: Any, is_free: Any = None) -> Any:
        if self.gone:
            return None
        self.gone = [next(one for one in self.ways if is_free(joints, one))]
        return self.gone[0]

    def solve(self) -> Any:
        raise NotImplementedError


def test_an_arm_goes_nowhere_beyond_the_limits_of_its_device_which_may_be_narrower() -> None:
    whole, home = FR3.arm_limits, np.array(FR3.home)
    narrow = ArmLimits(home - 0.1, home + 0.1, whole.joint_velocity)
    hardware = {"fr3": FakeArm(narrow, start=home), "wrist": "fake"}
    beyond, within = home + 0.12 * np.eye(7)[6], home + 0.05 * np.eye(7)[6]
    strategy = FirstFree(beyond, within)
    with rcs.make("Free", cameras="wrist", relative=False, hardware=hardware, max_episode_steps=None) as env:
        look_around(env, strategy, "wrist", robot="fr3")
    assert strategy.gone[0] is within
