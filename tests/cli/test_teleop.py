"""`rcs teleop`: a person leads, takes are recorded, figures are printed, and what is wrong is said first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.check import check

from rcs.cli.main import main
from rcs.cli.setup_options import Flags
from rcs.cli.teleop import TeleopCommand
from rcs.robots.fr3 import FR3
from rcs.setups.make import make
from rcs.teleop import HandReading, InputDevice, Operator
from tests.teleop.scripted_device import ScriptedDevice, at, held


def person(address: str | None) -> InputDevice:
    """A person who makes a take of half a second, in the middle of which they take the robot over, and stops."""

    def script(t: float) -> HandReading:
        buttons = {"start": (0.5, 0.6), "success": (1.1, 1.2), "takeover": (0.8, 0.9), "stop": (1.7, 2.0)}
        held_down = [name for name, (begin, end) in buttons.items() if begin <= t < end]
        return held(at(0.0, 0.02 * np.sin(t), 1.0), *(["clutch"] if t > 0.4 else []), *held_down)  # type: ignore[arg-type]

    device = ScriptedDevice(script, is_waiting=True)
    device.valid_for = 2.0  # a busy machine holds threads up
    return device


def judge(address: str | None) -> InputDevice:
    """Buttons alone."""
    return ScriptedDevice(lambda t: held(None, *(("discard",) if 0.8 < t < 0.9 else ())), is_waiting=True)


def stray(address: str | None) -> InputDevice:
    """A leader that is not where its follower is, with a clutch."""
    joints = np.array(FR3.home) + 0.4

    def script(t: float) -> HandReading:
        return held(None, *(("clutch",) if t > 0.3 else ()), *(("stop",) if t > 1.0 else ()), joints=joints + 1e-3 * t)

    device = ScriptedDevice(script, is_waiting=True)
    device.valid_for = 2.0  # a busy machine holds threads up
    return device


ME = f"{__name__}:person"


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["teleop", *arguments])
    return int(ended.value.code or 0)


def test_a_take_is_recorded_with_what_the_hand_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "takes"
    assert run("PickCuboid", "--input", ME, "--record", str(out), "--cameras", "--instruction", "lift it") == 0
    (episode,) = Dataset.open(out).episodes
    assert (episode.success, episode.instruction) == (True, "lift it")
    states = episode.info.feature("notes/right_state").words
    assert states[int(episode.column("notes/right_state")[-1]) - 1] == "engaged"
    actors = episode.info.feature("notes/actor").words
    assert {actors[int(number) - 1] for number in episode.column("notes/actor")[1:]} == {"person"}
    assert episode.column("notes/right_pose").shape == (episode.length, 7)
    assert 0.0 <= np.nanmedian(episode.column("notes/input_latency")) < 0.1
    assert not [one for one in check(out).findings if one.kind == "not_finite"]
    told = capsys.readouterr().out
    assert "Take 000000 begins: lift it" in told
    assert "right engaged" in told
    assert "Hz" in told
    assert "1 takes kept" in told


def test_an_agent_acts_until_the_person_takes_over(tmp_path: Path) -> None:
    out = tmp_path / "takes"
    assert (
        run("PickCuboid", "--input", ME, "--agent", "PickExpert", "--record", str(out), "--cameras", "--measure") == 0
    )
    (episode,) = Dataset.open(out).episodes
    words = episode.info.feature("notes/actor").words
    assert {words[int(number) - 1] for number in episode.column("notes/actor")[1:]} == {"policy", "person"}
    assert (episode.outcome or {})["latency"]["command"]["count"] > 0


def test_the_buttons_of_a_second_device_count(tmp_path: Path) -> None:
    out = tmp_path / "takes"
    assert run("Free", "--input", ME, f"{__name__}:judge", "--record", str(out), "--cameras") == 0
    assert not list(Dataset.open(out).episodes)


def test_why_a_leader_does_not_engage_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("Free", "--input", f"{__name__}:stray", "--cameras") == 0
    told = capsys.readouterr().out
    assert told.count("rad from the follower's; bring it within 0.2") == 1
    assert "right released: right: joint" in told


def test_a_person_leads_an_arm_with_a_hand_which_opens_and_closes_as_a_whole() -> None:
    command = TeleopCommand(task="PickToy", environment=Flags(robot="xarm7"))
    with make(command._setup()) as env:
        assert isinstance(command._agent(env, command._devices()), Operator)
    assert not TeleopCommand()._setup().binary_gripper
    assert TeleopCommand(environment=Flags(binary_gripper=True))._setup().binary_gripper


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["Free", "--input", "joistick"], "joistick"),
        (["Free", "--input", ME, "--lead", "right"], "hand=robot"),
        (["LiftBar", "--robot", "dual_fr3", "--input", ME, "--lead", "right=middle"], "middle"),
        (["Free", "--input", ME, "--scale", "0"], "scale"),
        (["PickCuboid", "--input", "spacemouse", "--agent", "PickExpert"], "--input spacemouse keyboard"),
        (["Free", "--input", ME, "--twin"], "simulated robots"),
    ],
)
def test_what_is_wrong_is_said(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) != 0
    told = capsys.readouterr()
    assert words in " ".join((told.out + told.err).split())
