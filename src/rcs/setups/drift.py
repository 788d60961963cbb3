"""A drift check of an environment's camera against a board of a calibration file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.verify import Drift
from rcs.envs.env import Env
from rcs.envs.observers.drift_check import DriftCheck
from rcs.envs.spaces import JOINTS, Observation, split_by_robot
from rcs.envs.start import base_in_scene
from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import kinematics_of
from rcs.setups.calibration import read_boards
from rcs.spatial import Pose


def drift_check(
    env: Env, camera: str, file: str | Path | None = None, *, board: str | None = None, drift: Drift | None = None
) -> DriftCheck:
    """Have an environment check, while it runs, that a camera still is where its calibration says.

    Args:
        env: The environment, which observes the camera; the check is added to its observers.
        camera: Name of the camera.
        file: Calibration file with the board; None for that of the environment's setup.
        board: Name of the board in the file; None for the one named as the camera, or the only one.
        drift: Judges the errors; None for usual limits.

    Raises:
        InvalidSetup: The file has no board, or several and none of the camera's name.
        UnknownName: There is no such board, or no such robot.
    """
    source = file or env.setup.cameras.calibration
    boards = {} if source is None else read_boards(source)
    if not boards:
        raise InvalidSetup(
            f"The calibration file {source} has no board in a known place; `rcs calibrate hand-eye` writes one."
        )
    name = board or (camera if camera in boards else next(iter(boards)) if len(boards) == 1 else None)
    if name is None:
        raise InvalidSetup(f"{source} has the boards {sorted(boards)}; say which camera {camera!r} sees.")
    if name not in boards:
        raise UnknownName("board in this calibration file", name, boards)
    known = boards[name]
    frame = Pose.from_tquat(base_in_scene(list(env.robots.values()))).inverse()  # the scene in the frame of extrinsics

    def in_scene(observation: Observation) -> NDArray[np.float64]:
        return (frame * known.mount.pose).matrix

    place: Any = in_scene
    if known.on_gripper_of is not None:
        if known.on_gripper_of not in env.robots:
            raise UnknownName("robot of this environment", known.on_gripper_of, env.robots)
        robot = env.robots[known.on_gripper_of]
        if robot.end_effector is None:
            raise InvalidSetup(f"The board is on the gripper of {robot.name!r}, which has none.")
        kinematics = kinematics_of(robot.arm)
        base = frame * robot.base_in_scene.pose
        board_in_flange = robot.end_effector.mount_in_flange.pose * known.mount.pose

        def on_gripper(observation: Observation) -> NDArray[np.float64]:
            joints = split_by_robot(env.robots, observation)[robot.name][JOINTS]
            return (base * kinematics.forward(np.ascontiguousarray(joints)) * board_in_flange).matrix

        place = on_gripper
    check = DriftCheck(camera, known.board, place, drift=drift, note=env.note)
    env.add_observer(check)
    return check
