"""Calibration files say where cameras are and how they see; a bad one is refused with what is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.errors import InvalidSetup
from rcs.setups.calibration import calibrated, read_calibration
from rcs.setups.labs.fr3 import LAB

SIDE: dict[str, Any] = {
    "translation": [0.4, 0.9, 0.6],
    "quaternion": [1.0, 0.0, 0.0, 0.0],
    "width": 640,
    "height": 480,
    "fx": 500.0,
    "fy": 500.0,
}


def write(folder: Path, camera: dict[str, Any], name: str = "side") -> Path:
    path = folder / "calibration.json"
    path.write_text(json.dumps({"cameras": {name: camera}}))
    return path


def test_a_calibrated_camera_is_where_the_file_says_and_sees_as_it_says(tmp_path: Path) -> None:
    lab = calibrated(LAB, write(tmp_path, SIDE))
    assert lab.cameras["side"].optical.translation == (0.4, 0.9, 0.6)
    assert lab.cameras["side"].fovy == pytest.approx(2 * np.arctan(240 / 500))
    assert lab.cameras["wrist"] == LAB.cameras["wrist"], "what the file does not name stays"


@pytest.mark.gl
def test_frames_carry_the_calibrated_matrices(tmp_path: Path) -> None:
    path = write(tmp_path, SIDE)
    env = rcs.make("Free", robot="fr3", cameras=("side",), image_size=(640, 480), calibration=str(path))
    frame = env.reset(seed=0)[0]["frames"]["side"]
    assert frame["intrinsics"][0, 0] == pytest.approx(500.0)
    np.testing.assert_allclose(frame["extrinsics"][:3, 3], SIDE["translation"], atol=1e-9)
    env.close()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"quaternion": [1.0, 1.0, 0.0, 0.0]}, "norm"),
        ({"fx": 600.0}, "square"),
        ({"fy": -1.0}, "square"),
        ({"translation": [0.0, 1.0]}, "not a calibration file"),
        ({"quaternion": None}, "not a calibration file"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        read_calibration(write(tmp_path, {**SIDE, **changes}))


def test_missing_files_and_unknown_cameras_are_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="cannot be read"):
        rcs.make("Free", robot="fr3", calibration=str(tmp_path / "none.json"))
    with pytest.raises(InvalidSetup, match=r"\['top'\].*side.*wrist"):
        calibrated(LAB, write(tmp_path, SIDE, name="top"))
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(InvalidSetup, match="not a calibration file"):
        read_calibration(tmp_path / "broken.json")
