"""`rcs calibrate`: a board to print, a lens from pictures, a camera's place, and a check that notices what moved."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcs.calibration import Board
from rcs.cli.main import main

pytestmark = [pytest.mark.extras, pytest.mark.gl]


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["calibrate", *words])
    assert isinstance(end.value.code, int)
    return end.value.code


def test_a_board_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("board", "--tag-size-mm", "50", "--out", str(tmp_path / "boards" / "small")) == 0
    assert (tmp_path / "boards" / "small.pdf").read_bytes().startswith(b"%PDF")
    assert "tag 50 mm, gap 12.5 mm" in capsys.readouterr().out


@pytest.mark.slow
def test_a_camera_is_found_and_checked_and_a_camera_that_moved_is_noticed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "lab.json"
    options = ["--camera", "side", "--views", "10"]
    assert run("hand-eye", *options, "--out", str(file)) == 0
    assert "standard deviation" in capsys.readouterr().out
    content = json.loads(file.read_text())
    np.testing.assert_allclose(content["cameras"]["side"]["optical"]["translation"], [0.74, 1.15, 0.78], atol=3e-4)
    assert content["boards"]["side"]["on_gripper_of"] == "fr3"
    check = ["check", "--camera", "side", "--views", "3", "--calibration", str(file)]
    assert run(*check) == 0
    content["cameras"]["side"]["optical"]["translation"][0] += 0.01
    file.write_text(json.dumps(content))
    assert run(*check) == 1
    assert "ALARM" in capsys.readouterr().out


@pytest.mark.slow
def test_intrinsics_come_from_the_robots_own_pictures_and_the_cameras_place_stays(tmp_path: Path) -> None:
    file = tmp_path / "lab.json"
    place = {"translation": [0.1, 0.2, 0.3], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    file.write_text(json.dumps({"cameras": {"wrist": {"optical": place}}}))
    assert run("intrinsics", "--camera", "wrist", "--out", str(file)) == 0
    about = json.loads(file.read_text())["cameras"]["wrist"]
    assert about["intrinsics"]["fx"] == pytest.approx(433.0, rel=5e-3)
    assert about["optical"]["translation"] == place["translation"]


def test_pictures_of_two_sizes_and_none_at_all_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import cv2

    assert run("intrinsics", "--pictures", str(tmp_path)) == 1
    assert "has no pictures" in capsys.readouterr().err
    cv2.imwrite(str(tmp_path / "a.png"), Board().picture(8))
    cv2.imwrite(str(tmp_path / "b.png"), Board().picture(9))
    assert run("intrinsics", "--pictures", str(tmp_path)) == 1
    assert "several sizes" in capsys.readouterr().err


def test_a_check_without_a_board_says_how_to_get_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lab.json"
    file.write_text('{"cameras": {}}')
    assert run("check", "--calibration", str(file)) == 1
    assert "rcs calibrate hand-eye --camera wrist" in capsys.readouterr().err
