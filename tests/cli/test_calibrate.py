"""`rcs calibrate`: a board to print, a lens from pictures, a camera's place, and a check that notices what moved."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.calibration import Board
from rcs.cli.calibrate.camera import SessionOptions, _ask
from rcs.cli.main import main
from rcs.devices.fakes import FakeArm
from rcs.envs.planner_for import planner_for
from rcs.errors import Refused
from rcs.hardware import FakeDriver
from rcs.robots import FR3, Mount
from rcs.robots.description import ArmDescription
from rcs.setups.calibration import KnownBoard

pytestmark = [pytest.mark.extras, pytest.mark.gl]


class Away(FakeDriver):
    """Driver of arms that are not at home."""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        arm = super().arm(address, about, options)
        arm.body.values = arm.body.target = np.array(about.home) + 0.2
        return arm


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["calibrate", *words])
    assert isinstance(end.value.code, int)
    return end.value.code


def test_a_board_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("board", "--tag-size-mm", "50", "--out", str(tmp_path / "boards" / "small")) == 0
    assert (tmp_path / "boards" / "small.pdf").read_bytes().startswith(b"%PDF")
    assert "tag 50 mm, gap 12.5 mm" in capsys.readouterr().out


def test_the_name_of_a_board_may_have_a_dot_and_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for size in ("79.6", "79.8"):
        assert run("board", "--tag-size-mm", size, "--out", str(tmp_path / f"board-{size}")) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["board-79.6.pdf", "board-79.8.pdf"]
    assert run("board", "--out", ".") == 1
    assert "out is '.'; valid is the path of a file" in capsys.readouterr().err


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
    assert run(*check, "--tag-size-mm", "41") == 1
    assert "leave the options of a board out" in capsys.readouterr().err
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


@pytest.mark.slow
def test_a_lens_that_the_file_knows_stays_as_it_is_when_the_camera_is_found(tmp_path: Path) -> None:
    file = tmp_path / "lab.json"
    lens = {"width": 848, "height": 480, "fx": 433.0, "fy": 433.0, "cx": 423.5, "cy": 239.5, "distortion": [0.0] * 5}
    file.write_text(json.dumps({"cameras": {"wrist": {"intrinsics": lens}}}))
    run("hand-eye", "--camera", "wrist", "--views", "8", "--accept", "--out", str(file))
    about = json.loads(file.read_text())["cameras"]["wrist"]
    assert "optical" in about
    assert {name: about["intrinsics"][name] for name in ("width", "height", "fx", "cy")} == {
        name: lens[name] for name in ("width", "height", "fx", "cy")
    }


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


def test_the_arm_that_holds_the_board_of_the_file_is_the_one_that_moves() -> None:
    options = SessionOptions(robot="dual_fr3", camera="front", image_size=(64, 48))
    held = KnownBoard(mount=Mount(translation=(0.0, 0.0, 0.2)), on_gripper_of="right")
    with options.session(options.setup(at=held)) as (mounted, _, _):
        assert mounted.robot.name == "right"


def test_ways_are_checked_against_the_other_arms_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arms = {name: f"{__name__}:Away:{name}" for name in ("left", "right")}
    site = rcs.Site(arms=arms, grippers=dict.fromkeys(arms, "fake"), cameras={"right_wrist": "fake"})
    site.write(tmp_path / "site.json")
    monkeypatch.setattr("rcs.cli.calibrate.camera.FreePath", lambda twin, robot: planner_for(twin, "left").joints)
    given: list[Any] = []
    monkeypatch.setattr("rcs.cli.calibrate.camera.look_around", lambda *_, is_free, **__: given.append(is_free))
    options = SessionOptions(robot="dual_fr3", camera="right_wrist", hardware=str(tmp_path / "site.json"))
    strategy: Any = None
    with options.session(options.setup()) as (_, _, look):
        look(strategy)
    np.testing.assert_allclose(given[0], np.array(FR3.home) + 0.2, atol=1e-6)


def test_an_input_that_ends_agrees_to_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(Refused, match="The input has ended"):
        _ask(np.zeros(7), np.full(7, 0.1))
