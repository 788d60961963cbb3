"""`rcs run` on devices: fakes in the place of real ones, judged by whoever watches, held when the policy is gone."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.ledger import Ledger

import rcs
from rcs.cli.main import main
from rcs.cli.run import RunCommand
from rcs.devices.fakes import FakeArm
from rcs.envs.env import Env

SERVE = """
import os, sys
import numpy as np
from vlagents import Metadata, PartSpec
from vlagents.policies.scripted import ScriptedPolicy
from vlagents import Server
joints, gripper = PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "0 closed, 1 open")
told = Metadata(name="swing", state=(joints,), action=(joints, gripper), rate=30.0, horizon=8)
calls = iter(range(int(sys.argv[1])))
def act(seen, _):
    if next(calls, None) is None:
        os._exit(9)
    rows = seen.state["joints"] + 0.3 * np.arange(1, 9)[:, None] / 30
    return np.hstack([rows, np.ones((8, 1))])
server = Server(ScriptedPolicy(act, told), port=0).start()
print(server.address, flush=True)
sys.stdin.read()
"""
WORDS = ["run", "--task", "Free", "--frequency", "30", "--cameras", "none"]


def serve(calls: int) -> tuple[subprocess.Popen[str], str]:
    command = [sys.executable, "-c", SERVE, str(calls)]
    served = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert served.stdout is not None
    return served, served.stdout.readline().strip()


@pytest.fixture
def address() -> Iterator[str]:
    served, where = serve(10**6)
    yield where
    served.kill()
    served.wait()


@pytest.fixture
def arms(monkeypatch: pytest.MonkeyPatch) -> list[FakeArm]:
    """The fake arms that were opened, in order."""
    opened: list[FakeArm] = []
    before = FakeArm.open

    def spied(self: FakeArm) -> None:
        before(self)
        opened.append(self)

    monkeypatch.setattr(FakeArm, "open", spied)
    return opened


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main([*WORDS, *arguments])
    return int(ended.value.code or 0)


def test_a_policy_moves_the_devices_of_a_site_and_a_person_judges(
    address: str, arms: list[FakeArm], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site.json"
    rcs.Site(arms={"fr3": "fake:a"}, grippers={"fr3": "fake:a"}).write(site)
    answers = iter(["", "y", "n", "?"])
    stays: list[bool] = []

    def answer(_: str = "") -> str:
        before = arms[0].state().joints
        time.sleep(0.1)
        stays.append(np.abs(arms[0].state().joints - before).max() < 1e-6)
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    out, data = tmp_path / "out", tmp_path / "data"
    words = ["--policy", address, "--hardware", str(site), "--judge", "--episodes", "3", "--max-episode-steps", "15"]
    assert run(*words, "--out", str(out), "--record", str(data)) == 0
    rows = list(Ledger(out).rows.values())
    assert [(row.success, row.judge) for row in rows] == [(True, "person"), (False, "person"), (None, "nobody")]
    assert all(row.is_real for row in rows)
    episodes = Dataset.open(data).episodes
    assert [episode.success for episode in episodes] == [True, False, None]
    joints = np.asarray(episodes[0].column("observation/joints"))
    assert np.abs(joints[-1] - joints[0]).max() > 0.02
    assert stays == [True] * 4, "with a recording, nothing is asked at the end"
    assert len({id(arm) for arm in arms}) == 1
    assert not arms[0].is_open


def test_devices_hold_when_the_server_dies_in_an_episode(
    arms: list[FakeArm], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[bool] = []
    hold = Env.hold

    def noted(self: Env) -> None:
        held.append(arms[0].is_open)
        hold(self)

    monkeypatch.setattr(Env, "hold", noted)
    served, address = serve(3)
    try:
        data = tmp_path / "data"
        words = [
            "--policy",
            address,
            "--hardware",
            "fake",
            "--episodes",
            "1",
            "--max-episode-steps",
            "60",
            "--on-loss",
            "end",
        ]
        assert run(*words, "--out", str(tmp_path / "out"), "--record", str(data)) == 0
        episode = Dataset.open(data).episodes[0]
        assert 2 < len(episode.column("notes/policy_is_held")) < 60
        assert served.wait(10) == 9
        assert any(held)
        assert not arms[0].is_open
    finally:
        served.kill()


def test_without_an_end_devices_stay_where_they_are_until_the_server_is_back(tmp_path: Path) -> None:
    served, address = serve(3)
    try:
        data = tmp_path / "data"
        words = ["--policy", address, "--hardware", "fake", "--episodes", "1", "--max-episode-steps", "60"]
        assert run(*words, "--out", str(tmp_path / "out"), "--record", str(data)) == 0
        episode = Dataset.open(data).episodes[0]
        held = np.asarray(episode.column("notes/policy_is_held")).astype(bool)
        joints = np.asarray(episode.column("observation/joints"))
        assert held[-20:].all()
        assert not held.all()
        np.testing.assert_allclose(joints[-15:], np.tile(joints[-1], (15, 1)), atol=1e-3)
    finally:
        served.kill()


def test_a_device_that_fails_ends_the_run_and_says_why(
    address: str, arms: list[FakeArm], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def trip() -> None:
        while not arms:
            time.sleep(0.05)
        time.sleep(1.5)
        arms[0].trip("collision")

    threading.Thread(target=trip, daemon=True).start()
    words = ["--policy", address, "--hardware", "fake", "--episodes", "3", "--max-episode-steps", "3000"]
    assert run(*words, "--out", str(tmp_path / "out")) == 1
    assert "collision" in capsys.readouterr().err
    assert [(row.failure, row.success) for row in Ledger(tmp_path / "out").rows.values()] == [("fault", None)]


def test_what_makes_no_sense_on_devices_is_refused_before_any_is_opened(
    address: str, arms: list[FakeArm], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for more, told in [(["--latency", "0.1"], "latency"), (["--hardware", "nothing:a"], "nothing"),
                       (["--videos", "1", "--record", str(tmp_path / "data")], "videos"),
                       (["--hardware", str(tmp_path / "none.json")], "none.json")]:  # fmt: skip
        words = ["--policy", address, "--hardware", "fake", *more, "--out", str(tmp_path / "out")]
        assert run(*words) == 1
        assert told in capsys.readouterr().err
    assert not arms


def test_episodes_on_devices_are_recorded_beside_the_loop_and_old_frames_are_flagged(tmp_path: Path) -> None:
    site = rcs.Site(arms={"fr3": "fake:a"}, grippers={"fr3": "fake:a"}, cameras={"wrist": "fake:b"}, stale_after=0.3)
    command = RunCommand(policy="vla://here", record=tmp_path / "data")
    with rcs.make("Free", cameras=("wrist",), hardware=site) as env, command._recorder(env) as recorder:
        assert recorder is not None
        assert (recorder._is_background, recorder._stale_after) == (True, 0.3)
