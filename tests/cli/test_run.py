"""`rcs run`: figures, page and recording of a served policy."""

from __future__ import annotations

import importlib.util
import sys
import threading
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.ledger import Ledger
from vlagents import Metadata, Observation, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy

from rcs.cli.main import main
from rcs.rollout.collection import seed_of
from rcs.rollout.evaluation import UNSEEN

EXAMPLE = Path(__file__).parents[2] / "examples" / "16_policy.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("policy_example", EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def address(example: ModuleType) -> Iterator[str]:
    with Server(example.policy(), port=0) as server:
        yield str(server.address)


def rcs(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def test_where_no_policy_is_the_error_has_one_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert rcs("run", "--policy", "vla://127.0.0.1:1", "--episodes", "1") == 1
    told = capsys.readouterr().err
    assert "error: ConnectionLost: No server is at" in told
    assert "RcsError" not in told


def test_a_served_policy_is_run_recorded_and_reported(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, data = tmp_path / "out", tmp_path / "data"
    command = ["run", "--policy", address, "--episodes", "2", "--seed", "3", "--latency", "0.1", "--mode", "rtc"]
    assert rcs(*command, "--out", str(out), "--record", str(data)) == 0
    ledger = Ledger(out)
    (condition,) = ledger.conditions.values()
    assert (condition.agent, condition.weights, condition.execution["mode"]) == ("scripted pick", None, "rtc")
    assert ledger.place(condition.hash) == address
    assert condition.versions["rcs-vlagents"] == version("rcs-vlagents")
    rows = list(ledger.rows.values())
    assert [row.seed for row in rows] == [UNSEEN + seed_of(3, number) for number in range(2)]
    for row in rows:
        assert row.latency_p50 is not None and row.latency_p99 is not None
        assert 0.0 < row.latency_p50 <= row.latency_p99 != 0.1, "as the clock has it, not as --latency has it"
    page = (out / "report.html").read_text()
    assert "scripted pick" in page
    assert "Wilson" in page
    episodes = Dataset.open(data).episodes
    assert [episode.id for episode in episodes] == [f"{number:06d}-{row.key}" for number, row in enumerate(rows)]
    assert {episode.seed: episode.success for episode in episodes} == {row.seed: row.success for row in rows}
    assert episodes[0].column("notes/policy_latency")[-1] == 0.1
    assert (data / "report.html").is_file()
    told = capsys.readouterr().out
    assert "success" in told
    assert "does not say which weights act" in told
    assert rcs(*command, "--out", str(tmp_path / "again")) == 0
    again = Ledger(tmp_path / "again").rows
    assert {name: (row.success, row.steps, row.reward) for name, row in again.items()} == {
        row.key: (row.success, row.steps, row.reward) for row in rows
    }
    before = (out / "ledger.jsonl").read_bytes()
    assert rcs(*command, "--out", str(out), "--record", str(data)) == 0
    assert (out / "ledger.jsonl").read_bytes() == before, "what is there is not run again"
    assert len(Dataset.open(data)) == 2
    assert rcs(*command, "--out", str(out), "--name", "other") == 0
    assert [row.agent for row in Ledger(out).rows.values()] == ["scripted pick"] * 2 + ["other"] * 2
    assert (out / "ledger.jsonl").read_bytes().startswith(before)


def test_a_policy_that_is_gone_ends_the_run_with_figures_of_the_episodes_before(
    example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.policy.agent.WAIT", 0.3)
    out, data = tmp_path / "out", tmp_path / "data"
    calls = 0

    def chunk(seen: Observation, instruction: str) -> Any:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise ValueError("no way to go")
        if calls == 5:
            threading.Thread(target=server.close).start()
        return example.chunk(seen, instruction)

    options = ["--episodes", "9", "--max-episode-steps", "90", "--out", str(out), "--record", str(data)]
    with Server(ScriptedPolicy(chunk, example.METADATA), port=0) as server:
        assert rcs("run", "--policy", str(server.address), *options) == 1
    said = capsys.readouterr()
    assert "No server is at" in said.err
    assert "not begun" in said.err
    (row,) = Ledger(out).rows.values()
    assert row.failure == "policy"
    assert "no way to go" in (row.message or "")
    assert "no way to go" in (out / "report.html").read_text()
    assert [episode.success for episode in Dataset.open(data).episodes] == [False]


def test_the_page_of_a_run_is_not_written_beside_another_evaluation(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "000000.mp4").write_bytes(b"a film of another agent")
    assert rcs("run", "--policy", address, "--episodes", "1", "--out", str(tmp_path)) == 1
    assert "Choose another folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["000000.mp4"]


def test_eval_takes_an_address_for_an_agent(address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--agent", address, "--episodes", "1", "--out", str(tmp_path), "--workers", "1"]
    assert rcs("eval", "PickCuboid", *options) == 1
    told = capsys.readouterr().err
    assert "do not fit" in told
    assert "'is_grasped'" in told


def test_what_is_no_address_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert rcs("run", "--policy", "somewhere") == 1
    assert "valid is an address" in capsys.readouterr().err


def test_a_policy_is_run_in_the_simulator_of_another_project(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(__file__).parents[2] / "packages" / "vlagents" / "tests" / "simulators"
    monkeypatch.setenv("PYTHONPATH", str(folder))
    arm, grip = PartSpec("xyzrpy", 6, "m, rad", "delta"), PartSpec("gripper", 1, "0 closed, 1 open")
    metadata = Metadata(name="still", action=(arm, grip), rate=20.0)
    with Server(ScriptedPolicy(lambda *_: np.zeros(7), metadata), port=0) as server:
        command = [
            "run",
            "--policy",
            str(server.address),
            "--episodes",
            "2",
            "--simulator",
            "tiny_simulator:Reach:near",
        ]
        command += ["--simulator-python", sys.executable]
        out = tmp_path / "out"
        assert rcs(*command, "--out", str(out), "--videos", "1", "--simulator-options", "fault=none") == 0
        ledger = Ledger(out)
        (condition,) = ledger.conditions.values()
        assert (condition.agent, condition.task, condition.robot) == ("still", "tiny:near", "tiny")
        assert condition.setup["task_options"]["mapping"]["wait"] == 2
        rows = list(ledger.rows.values())
        assert [(row.success, row.failure, row.steps) for row in rows] == [(False, "timeout", 60)] * 2
        assert ledger.film(rows[0]).is_file()
        before = (out / "ledger.jsonl").read_bytes()
        assert rcs(*command, "--out", str(out), "--simulator-options", "fault=none") == 0
        assert (out / "ledger.jsonl").read_bytes() == before
        assert rcs(*command, "--out", str(out), "--record", str(tmp_path / "data")) == 0
        assert len(Ledger(out).rows) == 4, "options of the simulator are part of the key"
        episodes = Dataset.open(tmp_path / "data").episodes
        assert [(one.success, one.outcome["failure"]) for one in episodes] == [(False, "timeout")] * 2
        assert [bool(flag) for flag in episodes[0].column("truncated")] == [False] * 60 + [True]
        assert rcs(*command, "--out", str(out), "--robot", "so101", "--real-time") == 1
        assert "robot, real_time cannot be combined with simulator" in capsys.readouterr().err
        assert rcs(*command, "--out", str(out), "--task", "Push") == 1
        assert "task cannot be combined with simulator" in capsys.readouterr().err
        alone = ["run", "--policy", str(server.address), "--out", str(out)]
        assert rcs(*alone, "--mapping", "m.json") == 1
        assert "mapping is of a simulator of another project, and none is named" in capsys.readouterr().err
        assert rcs(*alone, "--simulator-python", "p", "--simulator-options", "a=1") == 1
        assert "simulator_python, simulator_options is of a simulator" in capsys.readouterr().err
