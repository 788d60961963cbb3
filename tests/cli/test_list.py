"""`rcs list`: what is installed, and what is broken."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def test_list_names_robots_cameras_tasks_and_ids(call: Any) -> None:
    code, told = call("list")
    assert code == 0
    for word in ("fr3", "franka_hand", "realsense_d405", "realsense_d435", "PickCuboid", "rcs/FR3-v0"):
        assert word in told
    assert "DIGIT, on the pads of franka_hand, robotiq_2f85, so101_gripper" in " ".join(told.split())


def test_list_names_the_modes_of_every_camera(call: Any) -> None:
    code, told = call("list", "--cameras")
    assert code == 0
    rows = [line.split() for line in told.splitlines()]
    assert ["realsense_d435", "640x480", "6,", "15,", "30,", "60", "617.2", "0.175", "..", "3"] in rows
    assert ["usb_webcam", "640x480", "5,", "10,", "15,", "20,", "25,", "~30", "609.3", "-"] in rows


def test_list_names_what_is_broken_in_a_package_and_goes_on(
    call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = tmp_path / "torn_robot-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: torn-robot\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[rcs.arms]\ngone = torn_robot.gone:ARM\nfails = torn_robot.fails:ARM\nother = torn_robot:A_TEXT\n"
        "[rcs.cameras]\ngone_camera = torn_robot.gone:CAMERA\n"
        "[rcs.tasks]\nNoClass = torn_robot:NoClass\nNoSyntax = torn_robot.fails:Task\nFine = torn_robot:Fine\n"
    )
    package = tmp_path / "torn_robot"
    package.mkdir()
    (package / "__init__.py").write_text("A_TEXT = 'no arm'\nclass Fine:\n    'Do well.'\n")
    (package / "fails.py").write_text("class Task\n")
    monkeypatch.syspath_prepend(tmp_path)
    code, told = call("list")
    assert code == 0, told
    words = " ".join(told.split())
    for name, reason in (
        ("arm gone", "ModuleNotFoundError: No module named 'torn_robot.gone'"),
        ("arm fails", "SyntaxError: expected ':'"),
        ("arm other", "AttributeError: 'str' object has no attribute 'label'"),
        ("camera gone_camera", "ModuleNotFoundError"),
        ("task NoClass", "AttributeError: module 'torn_robot' has no attribute 'NoClass'"),
        ("task NoSyntax", "SyntaxError: expected ':'"),
    ):
        assert f"{name} broken: torn_robot" in words
        assert f"of the package torn-robot: {reason}" in words
    assert "task Fine Do well." in words
    assert "arm fr3 Franka Research 3" in words
    code, told = call("list", "--cameras")
    assert code == 0
    assert "gone_camera broken; see `rcs list`" in " ".join(told.split())
    assert "realsense_d435" in told
