"""`rcs virtual`: one line of JSON, an end on SIGTERM, and words for what cannot be."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, SimulationError, UnknownName
from rcs.hardware import Site
from rcs.virtual import VirtualProcess, read_events, running, tell

RCS = [sys.executable, "-m", "rcs", "virtual"]


def test_it_prints_its_name_and_site_and_ends_on_sigterm(tmp_path: Path) -> None:
    command = [*RCS, "so101", "--address", str(tmp_path / "arm"), "--log", str(tmp_path / "log"), "--seed", "3"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        site = Site(**told["site"])
        assert site.arms["so101"] == site.grippers["so101"]
        assert os.path.exists(site.arms["so101"].address)  # pyright: ignore[reportAttributeAccessIssue]
        assert told["name"] in running()
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
    assert told["name"] not in running()
    assert not (tmp_path / "arm").is_symlink()
    assert read_events(tmp_path / "log")[-1]["event"] == "end"


def test_one_that_runs_is_told_what_goes_wrong(tmp_path: Path) -> None:
    with VirtualProcess("so101", log=tmp_path / "log") as virtual:
        subprocess.run([*RCS, "tell", virtual.name, "overload", "elbow_flex"], check=True)
        refused = subprocess.run([*RCS, "tell", virtual.name, "reflex"], capture_output=True, text=True)
        assert refused.returncode == 1
        assert "overload JOINT" in " ".join(refused.stderr.split())
    told = [(event["fault"], event["value"]) for event in read_events(tmp_path / "log") if event["event"] == "told"]
    assert told == [("overload", "elbow_flex")]
    with pytest.raises(UnknownName):
        tell(virtual.name, ("cut",))


def test_a_setup_has_the_scene(tmp_path: Path) -> None:
    (tmp_path / "setup.json").write_text(json.dumps(Setup(task="Free", robot="so101").to_json()))
    with VirtualProcess("so101", setup=tmp_path / "setup.json", log=tmp_path / "log"):
        pass
    assert read_events(tmp_path / "log")[0]["setup"]["task"] == "Free"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["so102"], "so101"),
        (["so101", "--seed", "-1"], "2**63"),
        (["so101", "--setup", "/nowhere.json"], "/nowhere.json"),
        (["so101", "cut"], "tell NAME FAULT"),
        (["tell", "so101"], "takes the name"),
        ([], "tell NAME FAULT"),
    ],
)
def test_what_cannot_be_is_told(words: list[str], told: str, call_unwrapped: Callable[..., tuple[int, str]]) -> None:
    code, printed = call_unwrapped("virtual", *words)
    assert code != 0
    assert told in printed


def test_a_robot_that_cannot_start_or_fails_says_why() -> None:
    with pytest.raises(InvalidSetup, match="so101"), VirtualProcess("so102"):
        pass
    with pytest.raises(SimulationError, match="failed"), VirtualProcess("so101") as virtual:  # noqa: PT012
        os.kill(virtual.pid, signal.SIGKILL)
        os.waitid(os.P_PID, virtual.pid, os.WEXITED | os.WNOWAIT)
