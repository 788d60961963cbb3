"""`rcs run`: figures, page and recording of a served policy."""

from __future__ import annotations

import importlib.util
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from rcs_data import Dataset
from vlagents import Observation, Server
from vlagents.policies.scripted import ScriptedPolicy

from rcs.cli.main import main
from rcs.rollout import UNSEEN
from rcs.rollout.collect import seed_of

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
    command = ["run", "--policy", address, "--episodes", "2", "--seed", "3", "--latency", "0.1", "--execution", "rtc"]
    assert rcs(*command, "--out", str(out), "--record", str(data)) == 0
    figures = json.loads((out / "evaluation.json").read_text())
    assert figures["agent"] == address
    assert figures["execution"]["mode"] == "rtc"
    assert figures["policy"]["name"] == "scripted pick"
    assert [each["seed"] for each in figures["results"]] == [UNSEEN + seed_of(3, number) for number in range(2)]
    page = (out / "report.html").read_text()
    assert "scripted pick" in page
    assert "Wilson" in page
    episodes = Dataset.open(data).episodes
    assert [episode.success for episode in episodes] == [each["success"] for each in figures["results"]]
    assert episodes[0].column("notes/policy_latency")[-1] == 0.1
    assert (data / "report.html").is_file()
    assert "success" in capsys.readouterr().out
    assert rcs(*command, "--out", str(tmp_path / "again")) == 0
    again = json.loads((tmp_path / "again" / "evaluation.json").read_text())
    assert again["results"] == figures["results"]


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
    (result,) = json.loads((out / "evaluation.json").read_text())["results"]
    assert result["failure"] == "policy"
    assert "no way to go" in result["message"]
    assert "no way to go" in (out / "report.html").read_text()
    assert [episode.success for episode in Dataset.open(data).episodes] == [False]


def test_the_page_of_a_run_is_not_written_beside_another_evaluation(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "000000.mp4").write_bytes(b"a film of another agent")
    assert rcs("run", "--policy", address, "--episodes", "1", "--out", str(tmp_path)) == 1
    assert "another --out" in capsys.readouterr().err
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
