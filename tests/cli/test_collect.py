"""Files that `rcs collect` leaves on disk, and what other commands make of it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset

from rcs.setups.ids import ids
from rcs.setups.lab import lab_of


def test_collect_leaves_a_dataset_and_a_report(dataset: Path) -> None:
    assert len(Dataset.open(dataset)) == 2
    assert "<html" in (dataset / "report.html").read_text()


def test_collect_again_finds_everything_there(call: Any, dataset: Path) -> None:
    code, told = call(
        "collect", "PickCuboid", "--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(dataset)
    )
    assert code == 0
    assert "Nothing to do" in told


def test_of_more_episodes_than_were_asked_for_the_bar_is_full(call: Any, dataset: Path) -> None:
    code, told = call("collect", "PickCuboid", "--episodes", "1", "--cameras", "none", "--out", str(dataset))
    assert code == 0
    assert "1/1" in told
    assert "2/1" not in told


def test_randomised_episodes_are_collected_and_replayed(call: Any, tmp_path: Path) -> None:
    options = ["--episodes", "2", "--cameras", "none", "--workers", "1", "--out", str(tmp_path / "varied")]
    assert call("collect", "PickCuboid", "--randomisation", "default", *options)[0] == 0
    assert "object_mass" in Dataset.open(tmp_path / "varied").episodes[0].outcome["randomisation"]
    assert call("data", "replay", str(tmp_path / "varied"))[0] == 0


def test_info_tells_episodes_success_and_features(call: Any, dataset: Path) -> None:
    code, told = call("data", "info", str(dataset))
    assert code == 0
    for word in ("pick up the green cuboid", "Wilson", "observation/joints", "sha256"):
        assert word in told


def test_check_and_recover_are_content_with_a_good_dataset(call: Any, dataset: Path) -> None:
    assert call("data", "check", str(dataset))[0] == 0
    assert call("data", "recover", str(dataset))[0] == 0


def test_replay_finds_all_states_equal(call: Any, dataset: Path) -> None:
    code, told = call("data", "replay", str(dataset))
    assert code == 0
    assert "2 of 2 episodes bit-equal" in told


def test_check_finds_a_flipped_bit_and_fails(call: Any, dataset: Path, tmp_path: Path) -> None:

    copy = tmp_path / "copy"
    shutil.copytree(dataset, copy)
    steps = copy / "episodes" / "000001" / "steps.parquet"
    content = bytearray(steps.read_bytes())
    content[len(content) // 2] ^= 1
    steps.write_bytes(content)
    code, told = call("data", "check", str(copy))
    assert code == 1
    assert "000001" in told
    assert "000000" not in told


def test_collect_records_the_frames_of_tactile_sensors(call: Any, tmp_path: Path) -> None:
    out = str(tmp_path / "touch")
    options = ("--robot", "so101", "--cameras", "none", "--tactile", "digit", "--episodes", "1", "--workers", "1")
    code, _ = call("collect", "PickCuboid", *options, "--no-report", "--out", out)
    assert code == 0
    assert "observation/frames/so101_left/rgb" in (tmp_path / "touch" / "dataset.json").read_text()


PAIRS = [(task, robot) for task, robot in ids().values() if task != "Free"]


@pytest.mark.gl
@pytest.mark.parametrize(("task", "robot"), PAIRS)
def test_every_task_is_collected_with_the_cameras_of_its_robots_lab(
    call: Any, tmp_path: Path, task: str, robot: str
) -> None:
    options = ("--robot", robot, "--episodes", "1", "--workers", "1", "--image-size", "32")
    code, told = call("collect", task, *options, "--out", str(tmp_path / "set"))
    assert code == 0, told
    dataset = Dataset.open(tmp_path / "set")
    assert dataset.info.setup["cameras"]["names"] == list(lab_of(robot).cameras)
    assert dataset.episodes[0].success
