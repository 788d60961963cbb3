"""`rcs sim`: it serves, ends at Ctrl-C, and says what is wrong."""

from __future__ import annotations

import signal
import subprocess
import sys
import urllib.request

import pytest

from rcs.cli.main import main

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [*RCS, "sim", *arguments, "--cameras", "none", "--port", "0"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_a_page_until_it_is_told_to_end(number: signal.Signals) -> None:
    with start("PickCuboid", "--seed", "3") as process:
        assert process.stdout is not None
        told = process.stdout.readline()
        assert told.startswith("Open http://localhost:")
        assert "Ctrl-C" in told
        with urllib.request.urlopen(told.split()[1], timeout=30) as page:
            assert page.status == 200
        process.send_signal(number)
        out, errors = process.communicate(timeout=30)
        assert (process.returncode, out, errors) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["PickCubiod"], ["PickCubiod", "Did you mean 'PickCuboid'"]),
        (["PickCuboid", "--robot", "fr4"], ["fr4", "Did you mean 'fr3'"]),
        (["PickCuboid", "--cameras", "wirst"], ["wirst", "Did you mean 'wrist'"]),
        (["PickCuboid", "--task-options", "hold_time"], ["'hold_time'", "name=value"]),
        (["PickCuboid", "--frequency", "0"], ["frequency is 0"]),
        (["LiftBar", "--robot", "fr3"], ["--robot", "dual_fr3"]),
        (["PickCuboid", "--port", "70000"], ["port is 70000", "65535"]),
        (["PickCuboid", "--host", "nowhere.invalid"], ["nowhere.invalid"]),
        (["PickCuboid", "--seed", "-1"], ["seed", "-1"]),
    ],
)
def test_errors_say_what_is_wrong(arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sim", *arguments])
    told = capsys.readouterr().err
    assert ended.value.code == 1
    assert told.startswith("error: ")
    for word in words:
        assert word in told


def test_without_viser_the_command_to_install_it_is_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SystemExit) as ended:
        main(["sim", "PickCuboid", "--cameras", "none"])
    assert ended.value.code == 1
    assert "pip install 'robot-control-stack[view]'" in capsys.readouterr().err
