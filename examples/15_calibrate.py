"""Calibrate a camera: a board of AprilTags, automatically selected poses, a calibration file.

The wrist camera of this lab is some millimetres and degrees off the pose in its file, as after a bump. The arm starts
from that pose, looks at the board on the table, and calibrates. With a real robot, pass `hardware=` to `rcs.make` and a
function that asks a person before each motion, `confirm=`, to `look_around`.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import rcs
from rcs.calibration import BoardStrategy
from rcs.robots import Mount
from rcs.rollout import FreePath, Tour, look_around
from rcs.setups import MountedCamera, ShowBoardOptions, board_setup, lab_of, write_calibration
from rcs.spatial import Pose

with tempfile.TemporaryDirectory() as folder:
    # The actual, unknown lab: the camera was moved by (4, -3, 2) mm and turned by 2 degrees.
    before = lab_of("fr3").cameras["wrist"]
    assert before.calibration is not None
    moved = before.optical.pose * Pose.from_rotvec([0.004, -0.003, 0.002], np.deg2rad([0.0, 2.0, 0.0]))
    truth = Path(folder) / "truth.json"
    write_calibration(truth, {"wrist": replace(before.calibration, optical=Mount.of(moved))})

    setup = board_setup("fr3", "wrist")  # a board on the table, and the camera's pose from the lab
    mounted = MountedCamera.of(setup, "wrist")
    board = ShowBoardOptions(**setup.task_options)
    env = rcs.make(replace(setup, cameras=replace(setup.cameras, calibration=str(truth))))
    lens = Tour(env).intrinsics("wrist")
    strategy = BoardStrategy(mounted.rig(lens, board.mount.pose), board.board, views=12)
    look_around(env, strategy, "wrist", is_free=FreePath(env, "fr3"))
    found = strategy.solve()
    env.close()
    print(found)

    file = Path(folder) / "calibration.json"
    calibration = mounted.calibration(found, lens)
    write_calibration(file, {"wrist": calibration}, {"wrist": mounted.known_board(found, board.board)})
    assert calibration.optical is not None
    off = moved.inverse() * calibration.optical.pose
    print(
        f"off by {1000 * np.linalg.norm(off.translation):.3f} mm, {np.rad2deg(np.linalg.norm(off.rotvec)):.4f} degrees"
    )

    # Environments made with this file use the new pose.
    with rcs.make(replace(setup, cameras=replace(setup.cameras, calibration=str(file)))) as env:
        observation, _ = env.reset(seed=0)
        print(observation["frames"]["wrist"]["extrinsics"].round(3))
