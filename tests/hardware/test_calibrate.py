"""A camera is found over the wires: a virtual FR3 by its driver, the camera at its wrist by that of webcams."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rcs
from rcs.calibration import BoardStrategy
from rcs.rollout import FreePath, Tour, look_around
from rcs.setups import MountedCamera, ShowBoardOptions, board_setup
from rcs.virtual import VirtualProcess

pytest.importorskip("franky", reason="needs franky-control, the extra 'franka'")
pytest.importorskip("pupil_apriltags", reason="needs pupil-apriltags, the extra 'calibration'")
pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]
PATIENT = {"stale_after": 5.0, "arm_stale_after": 5.0}
"""Times for a busy machine."""
ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.7"


def test_hand_eye_over_the_wires_finds_the_camera_where_the_world_has_it(tmp_path: Path) -> None:
    setup = board_setup("fr3", "wrist")
    setup = replace(setup, cameras=replace(setup.cameras, fps=15))  # a busy machine draws no faster
    (tmp_path / "board.json").write_text(json.dumps(setup.to_json()))
    mounted, options = MountedCamera.of(setup, "wrist"), ShowBoardOptions.from_json(setup.task_options)
    with (
        VirtualProcess("fr3", address=ADDRESS, setup=tmp_path / "board.json", cameras=("wrist",)) as virtual,
        rcs.make(replace(setup, cameras=())) as twin,
        rcs.make(replace(setup, stepping="realtime"), hardware=replace(virtual.site, **PATIENT)) as env,
    ):
        assert set(env.platform.values()) == {"franka", "webcam"}
        twin.reset()
        rig = mounted.rig(Tour(env).intrinsics("wrist"), options.mount.pose)
        strategy = BoardStrategy(rig, options.board, views=12)
        look_around(env, strategy, "wrist", is_free=FreePath(twin, "fr3"))
        found = strategy.solve()
    off = rig.camera_in_mount.inverse() * found.camera_in_mount
    assert 1000 * np.linalg.norm(off.translation) <= 1.0
    assert np.rad2deg(np.linalg.norm(off.rotvec)) <= 0.1
