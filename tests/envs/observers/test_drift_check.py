"""While an environment runs, a camera that is not where its file says is noticed, and no step waits for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.calibration import Board
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots import Mount
from rcs.setups import KnownBoard, board_setup, drift_check, write_calibration
from rcs.spatial import Pose
from rcs.tasks import ShowBoardOptions

pytestmark = [pytest.mark.extras, pytest.mark.gl]


def file_of(folder: Path, camera: str, off: Pose) -> tuple[Path, rcs.Setup]:
    """Write where a board is, or not, and return the setup with it; the camera sees it from the start."""
    setup = board_setup("fr3", camera)
    options = ShowBoardOptions(**setup.task_options)
    held = "fr3" if options.on == "gripper" else None
    place = KnownBoard(board=options.board, mount=Mount.of(options.pose * off), on_gripper_of=held)
    write_calibration(folder / "lab.json", {}, {camera: place})
    return folder / "lab.json", setup


@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_an_offset_of_a_centimetre_raises_the_alarm_and_none_does_not(offset: float, tmp_path: Path) -> None:
    file, setup = file_of(tmp_path, "side", Pose([offset, 0.0, 0.0]))
    with rcs.make(setup) as env:
        check = drift_check(env, "side", file)
        joints = env.reset(seed=0)[0]["joints"]
        for i in range(8):
            env.step({"joints": joints + 0.02 * i * np.eye(7)[6], "gripper": np.ones(1, np.float32)})
            check.wait()
        assert check.pictures == 9 and check.missed == 0
        assert check.has_alarmed == (offset > 0)
        assert check.drift.pixels < 0.3 if offset == 0 else check.drift.pixels > 3.0


def test_the_error_is_recorded_beside_the_steps(tmp_path: Path) -> None:
    file, setup = file_of(tmp_path, "side", Pose())
    with rcs.make(replace(setup, stepping="async")) as env:
        check = drift_check(env, "side", file)
        with rcs.record_all(env, tmp_path / "takes", notes=("drift_px",)):
            joints = env.reset(seed=0)[0]["joints"]
            for _ in range(4):
                check.wait()
                env.step({"joints": joints, "gripper": np.ones(1, np.float32)})
    noted = Dataset.open(tmp_path / "takes").episodes[0].column("notes/drift_px")
    assert np.isfinite(noted[2:]).all() and noted[-1] < 0.5


def test_pictures_that_come_too_fast_are_missed_and_counted(tmp_path: Path) -> None:
    file, setup = file_of(tmp_path, "side", Pose())
    with rcs.make(setup) as env:
        check = drift_check(env, "side", file)
        joints = env.reset(seed=0)[0]["joints"]
        for i in range(5):
            env.step({"joints": joints + 0.01 * i * np.eye(7)[6], "gripper": np.ones(1, np.float32)})
        check.wait()
        assert check.pictures + check.missed == 6 and check.pictures >= 1
        check.close()
        check.close()


def test_a_file_without_a_board_and_a_board_of_another_name_are_refused(tmp_path: Path) -> None:
    file, setup = file_of(tmp_path, "side", Pose())
    write_calibration(tmp_path / "none.json", {})
    with rcs.make(setup) as env:
        with pytest.raises(InvalidSetup, match="no board in a known place"):
            drift_check(env, "side", tmp_path / "none.json")
        with pytest.raises(UnknownName, match="wall"):
            drift_check(env, "side", file, board="wall")
        two = KnownBoard(board=Board(), mount=Mount())
        write_calibration(tmp_path / "two.json", {}, {"a": two, "b": two})
        with pytest.raises(InvalidSetup, match="say which"):
            drift_check(env, "side", tmp_path / "two.json")
