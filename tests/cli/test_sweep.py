"""`rcs sweep`: every checkpoint is evaluated once, the best again on other seeds, and servers end with it."""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rcs_data.ledger import Ledger
from rcs_data.ledger.condition import key_of
from vlagents import Server

import rcs
from rcs.agents.identity import identity_of
from rcs.cli.main import main
from rcs.cli.sweep import checkpoints_in, name_of, wait_for_others
from rcs.errors import RcsError
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import Logbook, condition_of
from rcs.rollout.serving import own_gpu, serving
from tests.rollout.staying import claimed

EXAMPLES = Path(__file__).parents[2] / "examples"
SERVER = """
    import os, subprocess, sys
    from pathlib import Path
    from vlagents import Server
    sys.path.insert(0, {examples!r})
    import importlib
    from dataclasses import replace
    example = importlib.import_module("16_policy")
    checkpoint, port = Path(sys.argv[1]), int(sys.argv[2])
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    Path({out!r}, "pids").open("a").write(f"{{os.getpid()}} {{child.pid}} ")
    policy = example.policy()
    told = replace(example.METADATA, checkpoint=str(checkpoint), checkpoint_hash=(checkpoint / "weights").read_text())
    policy._metadata = told
    server = Server(policy, port=port).start()
    print("serving", checkpoint, flush=True)
    child.wait()
"""


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def command(tmp_path: Path) -> str:
    """A command that serves a checkpoint, whose server has a child."""
    program = tmp_path / "serve.py"
    program.write_text(textwrap.dedent(SERVER.format(examples=str(EXAMPLES), out=str(tmp_path))))
    return f"{sys.executable} {program} {{checkpoint}} {{port}}"


def test_whole_checkpoints_are_found_and_named_by_their_run(trained: Path) -> None:
    found = checkpoints_in(trained)
    assert [steps for steps, _ in found] == [1000, 2000]
    assert [name_of(path) for _, path in found] == ["act", "act"]
    assert checkpoints_in(trained / "run") == found


def test_paths_may_be_relative_to_a_folder_of_the_run_or_of_the_ledger(
    call_unwrapped: Any, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(trained / "run" / "checkpoints")
    found = checkpoints_in(Path(".."))
    assert [(steps, name_of(path)) for steps, path in found] == [(1000, "act"), (2000, "act")]
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    broken = f"{sys.executable} -c 1/0 {{checkpoint}} {{port}}"
    code, told = call_unwrapped("sweep", trained, "--serve", broken, "--out", ".")
    assert code == 1
    assert "ZeroDivisionError" in told
    assert (tmp_path / "out-server.log").is_file()


def test_checkpoints_of_a_run_that_was_copied_without_links_are_found(trained: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(trained, tmp_path / "copy")  # follows links, as scp does
    assert not (copy / "run" / "checkpoints" / "last").is_symlink()
    assert [steps for steps, _ in checkpoints_in(copy)] == [1000, 2000, 3000]
    (tmp_path / "disk").mkdir()
    (copy / "run" / "checkpoints").rename(tmp_path / "disk" / "moved")
    (copy / "run" / "checkpoints").symlink_to(tmp_path / "disk" / "moved")
    assert {name_of(path) for _, path in checkpoints_in(copy)} == {"copy"}


@pytest.mark.slow
def test_served_checkpoints_are_evaluated_the_best_again_and_no_server_is_left(
    call_unwrapped: Any, tmp_path: Path, trained: Path, command: str
) -> None:
    out = tmp_path / "out"
    words = (str(trained), "--serve", command, "--episodes", "2", "--max-episode-steps", "20", "--out", str(out))
    code, told = call_unwrapped("sweep", *words)
    assert code == 0, told
    assert "Best of 2, by the episodes above: 2000 steps" in told
    rows = list(Ledger(out).rows.values())
    assert [(row.agent, row.weights, row.trained) for row in rows] == [
        (name, weights, steps)
        for name, weights, steps in (
            ("act@1000", "3e8", 1000), ("act@2000", "7d0", 2000), ("act@2000 again", "7d0", 2000),
        )
        for _ in range(2)
    ]  # fmt: skip
    assert {row.seed for row in rows[:2]} == {row.seed for row in rows[2:4]}
    assert {row.seed for row in rows[:2]}.isdisjoint(row.seed for row in rows[4:])
    assert "over steps of training" in (out / "report.html").read_text()
    processes = [int(word) for word in (tmp_path / "pids").read_text().split()]
    assert len(processes) == 6
    assert not any(map(is_alive, processes))
    before = (out / "ledger.jsonl").read_bytes()
    code, told = call_unwrapped("sweep", *words)
    assert code == 0, told
    assert (out / "ledger.jsonl").read_bytes() == before


STAY = """
    import sys, threading
    import numpy as np
    from pathlib import Path
    from vlagents import Metadata, PartSpec, Server
    from vlagents.policies.scripted import ScriptedPolicy
    joints, gripper = PartSpec("joints", 7, "rad"), PartSpec("gripper", 1, "0 closed, 1 open")
    told = Metadata(name="stay", checkpoint_hash=Path(sys.argv[1], "weights").read_text(), state=(joints,),
                    action=(joints, gripper), rate=30.0, horizon=8)
    def act(seen, _):
        return np.hstack([np.tile(seen.state["joints"], (8, 1)), np.ones((8, 1))])
    server = Server(ScriptedPolicy(act, told), port=int(sys.argv[2])).start()
    threading.Event().wait()
"""


def test_real_episodes_follow_the_simulated_ones_of_each_checkpoint(
    call_unwrapped: Any, tmp_path: Path, trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, out = tmp_path / "stay.py", tmp_path / "out"
    program.write_text(textwrap.dedent(STAY))
    answers = iter(["", "y", "n", "", "", "n", "u", "y", "?", ""])
    monkeypatch.setattr("builtins.input", lambda _="": next(answers))
    words = (
        str(trained), "--serve", f"{sys.executable} {program} {{checkpoint}} {{port}}", "--task", "Free",
        "--frequency", "30", "--cameras", "none", "--max-episode-steps", "5", "--episodes", "3",
        "--hardware", "fake", "--real-episodes", "2", "--out", str(out),
    )  # fmt: skip
    for _ in range(2):
        code, told = call_unwrapped("sweep", *words)
        assert code == 0, told
    rows = list(Ledger(out).rows.values())
    found = [(row.agent, row.is_real, row.success) for row in rows]
    simulated, real = [found[i : i + 3] for i in (0, 5, 10)], [found[i : i + 2] for i in (3, 8)]
    assert simulated == [[(name, False, None)] * 3 for name in ("act@1000", "act@2000", "act@2000 again")]
    assert real == [
        [("act@1000", True, True), ("act@1000", True, False)],
        [("act@2000", True, True), ("act@2000", True, None)],
    ]
    assert [row.seed for row in rows[3:5]] == [row.seed for row in rows[:2]]


def test_episodes_that_another_process_runs_are_waited_for_and_run_here_if_it_dies(tmp_path: Path) -> None:
    setup = rcs.Setup(task="PickCuboid", max_episode_steps=4)
    evaluation, summary = Evaluation(setup=setup, agent="PickExpert", episodes=2, out=tmp_path), Summary()
    key = key_of(condition_of(evaluation, identity_of("PickExpert", "PickCuboid")).hash, evaluation.seed_of(1))
    Ledger.open(tmp_path).close()
    with claimed(tmp_path, key) as other:
        list(evaluate(evaluation, summary))
        assert [attempt.number for attempt in summary.attempts] == [0]
        threading.Timer(0.5, other.kill).start()
        assert wait_for_others(evaluation, summary, pause=0.1)
        assert other.wait(10.0) != 0
    list(evaluate(evaluation, summary))
    assert [attempt.number for attempt in summary.attempts] == [0, 1]
    assert not wait_for_others(evaluation, summary)


def test_a_sweep_that_looks_for_the_better_agent_waits_for_other_processes_too(
    call_unwrapped: Any, tmp_path: Path, trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, setup = tmp_path / "out", rcs.Setup(task="PickCuboid", max_episode_steps=4)
    list(evaluate(Evaluation(setup=setup, agent="PickExpert", name="other", episodes=2, out=out)))
    asked: set[str] = set()
    claim = Ledger.claim

    def later(ledger: Ledger, key: str, repeat: int = 0) -> bool:
        """Refuse every episode once, as if another process ran it, and died."""
        is_first = key not in asked
        asked.add(key)
        return not is_first and claim(ledger, key, repeat)

    monkeypatch.setattr(Ledger, "claim", later)
    monkeypatch.syspath_prepend(EXAMPLES)
    with Server(importlib.import_module("16_policy").policy(), port=0) as server:
        monkeypatch.setattr("rcs.cli.sweep.serving", lambda *_: nullcontext(str(server.address)))
        words = ("--episodes", "2", "--max-episode-steps", "4", "--until", "0.05", "--against", "other")
        code, told = call_unwrapped("sweep", str(trained), "--serve", "{checkpoint}", *words, "--out", str(out))
    assert code == 0, told
    names = ("other", "act@1000", "act@2000", "act@2000 again")
    assert [row.agent for row in Ledger(out).rows.values()] == [name for name in names for _ in range(2)]


def test_once_the_better_agent_is_known_nothing_is_waited_for(tmp_path: Path) -> None:
    setup = rcs.Setup(task="PickCuboid", max_episode_steps=4)
    better = Evaluation(setup=setup, agent="PickExpert", name="better", episodes=8, out=tmp_path)
    worse = replace(better, name="worse", against="better", until=0.05)
    identity = identity_of("PickExpert", "PickCuboid")
    done = EpisodeResult(seed=0, steps=4, success=True, failure=None, reward=0.0)
    failed = replace(done, success=False, failure="timeout")
    for evaluation, result, episodes in ((better, done, 8), (worse, failed, 7)):
        with Logbook(evaluation, identity, condition_of(evaluation, identity)) as book:
            for number in range(episodes):
                book.add(Attempt(number=number, result=result))
    summary = Summary()
    assert list(evaluate(worse, summary)) == []
    assert summary.is_decided
    assert not wait_for_others(worse, summary)


def test_what_is_wrong_with_a_run_or_a_command_is_said(
    call_unwrapped: Any, tmp_path: Path, trained: Path, command: str
) -> None:
    out = ("--out", str(tmp_path / "out"))
    for words, sentence in [
        ((str(tmp_path / "none"),), "There is no checkpoint in"),
        ((str(trained),), "is a checkpoint of LeRobot; say by --serve"),
        ((str(trained), "--page", "127.0.0.1:8080"), "name these by hardware"),
        ((str(trained), "--real-episodes", "3"), "real_episodes are on devices"),
        ((str(trained), "--mode", "ensemble", "--latency", "0.1"), "mode, latency is for chunks of a served policy"),
        ((str(trained), "--serve", "python -m mine {port}"), "has no {checkpoint}"),
        ((str(trained), "--serve", "x {checkpoint} {port}", "--workers", "2"), "serve has one process"),
        ((str(trained), "--serve", "x {checkpoint} {port}", "--ray", "auto"), "leave out workers and ray"),
        ((str(trained), "--serve", "python 'mine {checkpoint} {port}"), "No closing quotation. Correct its quotes"),
        ((str(trained), "--serve", "/nothing/here {checkpoint} {port}"), "Could not start '/nothing/here'"),
        ((str(trained), "--serve", f"{sys.executable} -c 1/0 {{checkpoint}} {{port}}"), "ZeroDivisionError"),
    ]:
        code, told = call_unwrapped("sweep", *words, *out)
        assert code == 1
        assert sentence in told
        assert "Traceback" not in told or "ZeroDivisionError" in told
    assert not (tmp_path / "out" / "ledger.jsonl").exists()


def test_a_server_that_never_answers_is_ended(tmp_path: Path) -> None:
    began, silent = time.monotonic(), f"{sys.executable} -c 'import time; time.sleep(600)' {{checkpoint}} {{port}}"
    with (
        pytest.raises(RcsError, match="does not answer after 1 s"),
        serving(silent, tmp_path, tmp_path / "log", patience=1.0),
    ):
        pass
    assert time.monotonic() - began < 30


@pytest.mark.extras
def test_checkpoints_of_a_training_are_swept_and_go_on(call_unwrapped: Any, tmp_path: Path) -> None:
    run, out = tmp_path / "pick", tmp_path / "out"
    small = (
        "--steps", "240", "--copies", "2", "--episodes", "2", "--evaluate-every", "120", "--max-episode-steps", "6",
        "--threads", "1", "--torch-threads", "1", "--no-video",
    )  # fmt: skip
    with pytest.raises(SystemExit) as stopped:
        main(["train", "PickCuboid", "--out", str(run), *small])
    assert not stopped.value.code
    code, told = call_unwrapped("sweep", str(run), "--episodes", "3", "--follow", "--out", str(out))
    assert code == 0, told
    names = list(dict.fromkeys(row.agent for row in Ledger(out).rows.values()))
    assert len(names) == len(checkpoints_in(run)) + 1
    assert all({"torch", "stable-baselines3"} <= one.versions.keys() for one in Ledger(out).conditions.values())
    assert names[-1].endswith(" again")
    assert all(name.startswith("pick@") for name in names)


@pytest.mark.slow
def test_a_server_and_its_children_end_with_the_program_that_started_it_even_if_that_is_killed(tmp_path: Path) -> None:
    log = tmp_path / "log"
    program = (
        "import pathlib, time; from rcs.rollout.serving import ServerProcess\n"
        f"server = ServerProcess(['sh', '-c', 'sleep 600 & echo $$ $!; wait'], pathlib.Path({str(log)!r}))\n"
        "print('started', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        assert starter.stdout.readline() == "started\n"
        until = time.monotonic() + 20
        while not log.read_text().endswith("\n") and time.monotonic() < until:
            time.sleep(0.05)
        processes = [int(word) for word in log.read_text().split()]
        assert [is_alive(process) for process in processes] == [True, True]
        starter.kill()
    until = time.monotonic() + 20
    while any(map(is_alive, processes)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(is_alive, processes))


def test_servers_at_a_time_have_a_gpu_each(command: str, trained: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,GPU-5")

    def seen() -> str:
        process = int((trained.parent / "pids").read_text().split()[-2])
        words = Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
        return next(word for word in words if word.startswith(b"CUDA_VISIBLE_DEVICES=")).decode().partition("=")[2]

    checkpoint = checkpoints_in(trained)[0][1]
    with serving(command, checkpoint, trained.parent / "one.log"):
        assert seen() == "4"
        with serving(command, checkpoint, trained.parent / "two.log"):
            assert seen() == "GPU-5"
            with own_gpu() as third:
                assert third is None, "all are taken, so nobody chooses"
    with own_gpu() as again:
        assert again == "4", "a server that has ended gives it back"
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4")
    with own_gpu() as only:
        assert only is None, "there is nothing to choose from"
