"""`rcs eval`: figures, videos, Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from rcs_data.ledger import Ledger

from tests.rollout.staying import Stay

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


@pytest.mark.gl
def test_it_tells_the_rate_and_leaves_figures_and_videos(call: Any, tmp_path: Path) -> None:
    options = ("--episodes", "3", "--videos", "1", "--workers", "1", "--out", str(tmp_path / "e"))
    code, told = call("eval", "PickCuboid", *options)
    assert code == 0
    assert "3 of 3 = 100.0 % (95 % Wilson interval" in told
    ledger = Ledger(tmp_path / "e")
    rows = list(ledger.rows.values())
    assert [(row.agent, row.success) for row in rows] == [("PickExpert", True)] * 3
    assert [ledger.film(row).is_file() for row in rows] == [True, False, False]
    assert "report.html" in told
    assert rows[0].key in (tmp_path / "e" / "report.html").read_text()


def test_options_of_the_task_and_layers_are_part_of_the_setup(call: Any, tmp_path: Path) -> None:
    options = ("--task-options", "lift_height=0.05", "hold_time=0.5", "--reward", "sparse")
    layers = ("--layers", "rcs.envs.layers:BinaryGripper", "--frequency", "20", "--relative", "absolute")
    code, told = call(
        "eval", "PickCuboid", *options, *layers, "--episodes", "1", "--workers", "1", "--out", str(tmp_path)
    )
    assert code == 0, told
    ((_, condition),) = Ledger(tmp_path).conditions.items()
    setup = condition.setup
    assert setup["task_options"] == {"lift_height": 0.05, "hold_time": 0.5}
    assert (setup["reward"], setup["discount"]) == ("sparse", 0.99)
    assert setup["layers"] == ["rcs.envs.layers:BinaryGripper"]
    assert (setup["frequency"], setup["relative"]) == (20.0, "absolute")


def test_nothing_runs_twice_and_nothing_is_overwritten(
    call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    short = ("PickCuboid", "--workers", "1", "--max-episode-steps", "3")
    path = tmp_path / "evaluation" / "ledger.jsonl"
    kept = b""
    for more, rows, found in [
        (("--episodes", "2"), 2, None),
        (("--episodes", "3"), 3, "2 of 3 episodes were in the ledger"),
        (("--episodes", "3"), 3, "none was run"),
        (("--episodes", "3", "--seed", "1"), 6, None),
        (("--episodes", "3", "--physics-step", "0.001"), 9, None),
        (("--episodes", "3", "--repeat", "1"), 12, "3 of 6 episodes were in the ledger"),
        (("--episodes", "3", "--repeat", "1"), 12, "none was run"),
        (("--episodes", "1", "--agent", "rcs.agents:PickExpert", "--name", "mine"), 13, None),
    ]:
        code, told = call("eval", *short, *more)
        assert code == 0, told
        assert (found or "success") in told
        assert ("were in the ledger" in told) == (found is not None)
        assert len(Ledger(tmp_path / "evaluation").rows) == rows, more
        assert path.read_bytes().startswith(kept)
        kept = path.read_bytes()


def test_the_bar_counts_the_episodes_that_the_command_runs(call: Any, tmp_path: Path) -> None:
    short = ("PickCuboid", "--workers", "1", "--max-episode-steps", "3", "--out", str(tmp_path))
    for more, count in [(("--episodes", "2"), "2/2"), (("--episodes", "2", "--repeat", "3"), "6/6")]:
        code, told = call("eval", *short, *more)
        assert code == 0, told
        assert count in told


def test_two_agents_are_compared_and_decided_between(call: Any, tmp_path: Path) -> None:
    short = ("--workers", "1", "--out", str(tmp_path), "--max-episode-steps", "200")
    code, told = call("eval", "PickCuboid", *short, "--episodes", "8")
    assert code == 0, told
    agent = ("--agent", f"{Stay.__module__}:Stay", "--name", "idle", "--until", "0.05", "--against", "PickExpert")
    code, told = call("eval", "PickCuboid", *short, *agent, "--episodes", "6")
    assert code == 0, told
    assert "Not shown that idle and PickExpert differ on 6 shared seeds" in told.replace("\n", " ")
    code, told = call("eval", "PickCuboid", *short, *agent, "--episodes", "50")
    assert code == 0, told
    assert "is better than idle on 7 shared seeds" in told.replace("\n", " ")
    assert len(Ledger(tmp_path).of(Ledger(tmp_path).find("idle"))) == 7


def test_an_agent_is_compared_with_itself_under_another_condition(call_unwrapped: Any, tmp_path: Path) -> None:
    short = ("eval", "PickCuboid", "--workers", "1", "--episodes", "2", "--max-episode-steps", "3", "--out", tmp_path)
    code, told = call_unwrapped(*short)
    assert code == 0, told
    for _ in range(2):
        code, told = call_unwrapped(*short, "--frequency", "10", "--until", "0.05", "--against", "PickExpert")
        assert code == 0, told
        assert "differ on 2 shared seeds" in told
    assert len(Ledger(tmp_path).rows) == 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["PickCuboid", "--agent", "PickExpart"], ["PickExpart", "Did you mean 'PickExpert'"]),
        (["PickCuboid", "--layers", "BinaryGriper"], ["BinaryGriper"]),
        (["PickCuboid", "--task-options", "hold_time"], ["'hold_time'", "name=value"]),
        (["PickCuboid", "--task-options", "hold_tyme=1"], ["hold_tyme", "Did you mean 'hold_time'"]),
        (["PickCuboid", "--task-options", "reward=sparse"], ["no option of a task but of the setup"]),
        (["PickCuboid", "--reward", "dense", "--discount", "1"], ["discount is 1"]),
        (["PickCuboid", "--videos", "-1"], ["videos is -1"]),
        (["PickCuboid", "--workers", "-1"], ["workers is -1"]),
        (["PickCuboid", "--until", "0.05"], ["until, against and out belong together"]),
        (["PickCuboid", "--until", "0.05", "--against", "idle"], ["no ledger", "nothing to decide against"]),
        (["Free"], ["no scripted expert"]),
        (["PickCuboid", "--task-options", "placed_by=robot"], ["only a collection does", "placed_by='reset'"]),
    ],
)
def test_bad_arguments_get_a_clear_error_and_leave_nothing(
    call: Any, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    code, told = call("eval", "--workers", "1", *arguments, "--out", str(tmp_path / "e"))
    assert code == 1
    assert "Traceback" not in told
    for word in words:
        assert word in told.replace("\n", " ")
    assert not (tmp_path / "e").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_ends_after_the_episodes_at_work_and_keeps_the_figures(tmp_path: Path, workers: str) -> None:
    options = ["PickCuboid", "--episodes", "500", "--workers", workers, "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*RCS, "eval", *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    end = time.monotonic() + 60.0
    path = tmp_path / "ledger.jsonl"
    while not (path.exists() and path.stat().st_size > 1000) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Ending after the running episodes" in told
    assert "Traceback" not in told
    assert 1 <= len(Ledger(tmp_path).rows) < 500
    assert (tmp_path / "report.html").is_file()
