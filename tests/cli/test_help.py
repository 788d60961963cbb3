"""Text of the help of a command about its options."""

from __future__ import annotations

import re

import pytest

from rcs.cli.main import main
from rcs.cli.sim import SimCommand
from rcs.sim.randomisation import Randomisation


def help_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--help"])
    assert not ended.value.code
    lines = capsys.readouterr().out.replace("│", " ").splitlines()
    return " ".join(" ".join(lines).split())


COMMANDS = ("collect", "train", "eval", "run", "sim", "data export", "data import",
            "data mix", "data split", "data recover", "calibrate hand-eye")  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_values_are_named_after_what_they_are(capsys: pytest.CaptureFixture[str], command: str) -> None:
    told = help_of(capsys, *command.split())
    assert not re.search(r"\bSTR\b|\{None|\[\[|\(default: (None|False)?\)", told)


def test_an_option_has_its_value_and_its_default(capsys: pytest.CaptureFixture[str]) -> None:
    told = help_of(capsys, "collect")
    assert "usage: rcs collect [-h] [OPTIONS] TASK" in told
    for words in (
        "--robot [ROBOT ...] Robot by name",
        "--end-effector [EFFECTOR ...] Name of the gripper or hand",
        "--cameras [CAMERA ...] Cameras of",
        "--image-size [INT ...] Width and height of every frame [px]",
        "--camera-fps [FLOAT ...] ",
        "--control {joints,tquat,xyzrpy,twist} ",
        "--observe [{torques,wrench,contacts,privileged} ...] ",
        "--task-options [NAME=VALUE ...] ",
        "--seed INT Random seed of the episodes. (default: 0)",
        "--depth [{true,false}] Add depth to frames",
    ):
        assert words in told


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("train", "--video, --no-video Film an episode at every evaluation, for the report. (default: True)"),
        ("data export", "--compress, --no-compress Whether to compress"),
        ("collect", "--collision-reaction [{true,false}] Put a simulated arm that collides into its fault state"),
        ("collect", "--report, --no-report Write report.html. (default: True)"),
    ],
)
def test_what_is_on_by_default_has_both_words(capsys: pytest.CaptureFixture[str], command: str, words: str) -> None:
    assert words in help_of(capsys, *command.split())


def test_of_a_simulation_it_says_that_nobody_acts_unless_asked(capsys: pytest.CaptureFixture[str]) -> None:
    told = help_of(capsys, "sim")
    assert "By default the task's expert" not in told
    assert "--agent AGENT Agent that acts in your place" in told


@pytest.mark.parametrize(
    ("words", "preset"),
    [
        (["PickCuboid", "--randomisation", "--paused"], "default"),
        (["--randomisation", "PickCuboid"], "default"),
        (["PickCuboid", "--randomisation"], "default"),
        (["PickCuboid", "--randomisation", "strong"], "strong"),
        (["PickCuboid"], "none"),
    ],
)
def test_randomisation_alone_is_the_default_preset(
    monkeypatch: pytest.MonkeyPatch, words: list[str], preset: str
) -> None:
    seen: list[SimCommand] = []

    def run(self: SimCommand) -> int:
        seen.append(self)
        return 0

    monkeypatch.setattr(SimCommand, "run", run)  # what is tested is what it is given
    with pytest.raises(SystemExit) as ended:
        main(["sim", *words])
    assert not ended.value.code
    assert [one.setup().randomisation for one in seen] == [Randomisation.of(preset)]


def test_an_unknown_preset_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sim", "PickCuboid", "--randomisation", "wild"])
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert "mild" in told.out + told.err
