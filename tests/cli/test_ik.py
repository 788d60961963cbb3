from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from rcs.cli.main import main
from rcs.devices import lookup
from rcs.kinematics import kinematics_of
from rcs.spatial import Pose

POSE = ("0.45", "-0.15", "0.35", "3.1416", "0", "0.2")


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["ik", *arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out + captured.err


def joints_in(text: str) -> np.ndarray:
    return np.array([float(value) for value in re.findall(r"^\S+ +(-?\d+\.\d{6}) ", text, re.MULTILINE)])


@pytest.mark.parametrize(("robot", "gripper"), [("fr3", "franka_hand"), ("ur5e", "robotiq_2f85")])
def test_the_joints_that_are_printed_bring_the_tcp_to_the_pose(
    capsys: pytest.CaptureFixture[str], robot: str, gripper: str
) -> None:
    code, text = call(capsys, robot, "--pose", *POSE)
    assert code == 0
    assert "status: ok" in text
    reached = kinematics_of(lookup.find("arm", robot), lookup.find("gripper", gripper)).forward(joints_in(text))
    numbers = [float(word) for word in POSE]
    assert reached.is_close(Pose.from_rpy(numbers[:3], numbers[3:]), 1.1e-4, 1.1e-4)


def test_the_elbow_is_where_it_is_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    code, text = call(capsys, "fr3", "--pose", *POSE, "--elbow", "0.4")
    assert code == 0
    assert "elbow: 0.4" in text or "elbow: 0.39" in text


def test_what_is_out_of_reach_has_exit_code_1_and_no_joints_but_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    far = ("3", "0", "0.5", "0", "0", "0")
    code, text = call(capsys, "ur5e", "--pose", *far)
    assert code == 1
    assert "status: infeasible" in text
    assert "--nearest" in text
    assert joints_in(text).size == 0, "no joints look like an answer"
    code, text = call(capsys, "ur5e", "--pose", *far, "--nearest")
    assert code == 1
    assert "status: nearest" in text
    assert float(re.findall(r"residual: ([\d.]+) mm", text)[0]) > 1000


def test_an_arm_with_five_joints_leans_where_it_cannot_turn(capsys: pytest.CaptureFixture[str]) -> None:
    code, text = call(capsys, "so101", "--pose", "0.25", "0.05", "0.1", "0", "1.57", "0")
    assert code == 1
    assert "status: nearest" in text
    translation, rotation = map(float, re.findall(r"residual: ([\d.]+) mm, ([\d.]+) mrad", text)[0])
    assert translation < 0.5
    assert rotation > 1.0


def test_an_arm_with_five_joints_meets_a_pose_that_it_can_reach(capsys: pytest.CaptureFixture[str]) -> None:
    arm, gripper = lookup.find("arm", "so101"), lookup.find("gripper", "so101_gripper")
    pose = kinematics_of(arm, gripper).forward(np.array(arm.home) + 0.1)
    numbers = [*pose.translation, *pose.rpy]
    code, text = call(capsys, "so101", "--pose", *map(str, numbers))
    assert code == 0
    assert "status: ok" in text


@pytest.mark.gl
def test_a_picture_is_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "ik.png"
    code, text = call(capsys, "fr3", "--pose", *POSE, "--picture", str(path))
    assert code == 0
    assert str(path) in text
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("dual_fr3", "--pose", *POSE), "has 2 arms; inverse kinematics is of one: fr3"),
        (("ur5e", "--pose", *POSE, "--start", "1", "2"), "has 6 joints"),
        (("ur5e", "--pose", *POSE, "--elbow", "0.1"), "only with 7 the elbow moves"),
        (("nobody", "--pose", *POSE), "nobody"),
        (("ur5e", "--pose", "0.4", "0", "0.3", "nan", "0", "0"), "--pose is 0.4 0.0 0.3 nan 0.0 0.0; valid are six"),
        (("ur5e", "--pose", "inf", "0", "0.3", "0", "0", "0"), "six finite numbers"),
        (("fr3", "--pose", *POSE, "--elbow", "nan"), "--elbow is nan"),
        (("ur5e", "--pose", *POSE, "--start", "0", "9", "0", "0", "0", "0"), "shoulder_lift_joint is 9.0; valid is -"),
        (("ur5e", "--pose", *POSE, "--start", "nan", "0", "0", "0", "0", "0"), "shoulder_pan_joint is nan"),
    ],
)
def test_what_makes_no_sense_is_refused(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    code, text = call(capsys, *arguments)
    assert code != 0
    assert "Traceback" not in text
    assert told in " ".join(text.split())
