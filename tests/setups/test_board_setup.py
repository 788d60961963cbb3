"""The simulated board is where its options say, on what they say, and looks like the printed one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.calibration import detect
from rcs.calibration.board_pose import project
from rcs.envs.assemble import compose
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.mount import Mount
from rcs.setups import ShowBoard, ShowBoardOptions, board_setup
from rcs.setups.calibration import KnownBoard
from rcs.setups.make import resolve
from rcs.spatial import Intrinsics

pytestmark = pytest.mark.extras


@pytest.mark.gl
def test_tags_are_drawn_where_geometry_has_them() -> None:
    setup = board_setup("fr3", "side")
    options = ShowBoardOptions(**setup.task_options)
    with rcs.make(setup) as env:
        frame: dict[str, Any] = env.reset(seed=0)[0]["frames"]["side"]
        board_in_scene = np.eye(4)
        world = env.simulation.world
        body = world.model.body("board").id
        assert world.data is not None
        board_in_scene[:3, :3] = world.data.xmat[body].reshape(3, 3)
        board_in_scene[:3, 3] = world.data.xpos[body]
    found = detect(options.board, frame["rgb"])
    assert len(found) >= 2
    lens = Intrinsics.of_matrix(frame["intrinsics"], (640, 480))
    expected = project(np.linalg.inv(frame["extrinsics"]) @ board_in_scene, options.board.corners_of(found.ids))
    np.testing.assert_allclose(expected * (lens.fx, lens.fy) + (lens.cx, lens.cy), found.corners, atol=0.5)


def test_a_board_on_a_gripper_moves_with_it_and_one_in_the_scene_stays() -> None:
    for holder, moves in (("fr3", True), (None, False)):
        options = {"on_gripper_of": holder, "mount": {"translation": (0.3, 0.0, 0.25)}}
        with rcs.make(ShowBoard, robot="fr3", relative=False, stepping="sync", task_options=options) as env:
            joints = env.reset(seed=0)[0]["joints"]
            world = env.simulation.world
            assert world.data is not None
            body = world.model.body("board").id
            before = world.data.xpos[body].copy()
            env.step({"joints": joints + 0.1 * np.eye(7)[0], "gripper": np.ones(1, np.float32)})
            assert (np.abs(world.data.xpos[body] - before).max() > 0.01) == moves


def test_a_board_on_a_gripper_that_is_not_there_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="bare flange"):
        rcs.make(ShowBoard, robot="fr3", end_effector="none", task_options={"on_gripper_of": "fr3"})
    with pytest.raises(UnknownName, match="'left'"):
        rcs.make(ShowBoard, robot="fr3", task_options={"on_gripper_of": "left"})


@pytest.mark.parametrize("name", ["left", "right"])
def test_a_known_board_is_on_the_gripper_of_the_robot_that_is_named(name: str) -> None:
    held = KnownBoard(mount=Mount(translation=(0.0, 0.0, 0.2)), on_gripper_of=name)
    model = compose(resolve(board_setup("dual_fr3", "front", at=held))).compile()
    carrier = model.body(int(model.body("board").parentid[0])).name
    assert carrier.startswith(f"{name}/gripper/")


@pytest.mark.parametrize(
    ("robot", "camera", "on_gripper_of", "text"),
    [
        ("fr3", "side", None, "has on_gripper_of=None; valid is the name of a robot for a camera that stands still"),
        ("fr3", "wrist", "fr3", "has on_gripper_of='fr3'; valid is .*None, a board in the scene, for one on a gripper"),
        ("dual_fr3", "left_wrist", "right", "is on the gripper of 'left', not of 'right'"),
    ],
)
def test_a_known_board_whose_carrier_does_not_fit_the_camera_is_refused(
    robot: str, camera: str, on_gripper_of: str | None, text: str
) -> None:
    with pytest.raises(InvalidSetup, match=text):
        board_setup(robot, camera, at=KnownBoard(mount=Mount(), on_gripper_of=on_gripper_of))
