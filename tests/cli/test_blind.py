"""`rcs run --blind`: whoever judges finds no name anywhere before `rcs unblind`, and no answer is lost."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.ledger import Ledger
from rcs_data.ledger.compare import compare
from vlagents import Metadata, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy

import rcs
from rcs.rollout import Evaluation
from rcs.rollout.blind import order_of

NAMES = ("alphabet", "betamax")
RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]
METADATA = Metadata(
    name="any", horizon=8, rate=30.0, state=(PartSpec("joints", 7),),
    action=(PartSpec("joints", 7, "rad"), PartSpec("gripper", 1)),
)  # fmt: skip


@pytest.fixture
def addresses() -> Iterator[list[str]]:
    """The addresses of two policies that stay where they are, with names and hashes of their own."""

    def act(seen: Any, instruction: str) -> Any:
        return np.hstack([np.tile(seen.state["joints"], (8, 1)), np.ones((8, 1))])

    policies = [
        ScriptedPolicy(
            act,
            replace(
                METADATA,
                name=name,
                checkpoint=f"runs/{name}",
                checkpoint_hash=f"{name}hash",
                data_hash=f"{name}data",
            ),
        )
        for name in NAMES
    ]
    servers = [Server(policy, port=0).start() for policy in policies]
    yield [str(server.address) for server in servers]
    for server in servers:
        server.close()


def test_the_order_is_balanced_and_drawn_from_the_seed() -> None:
    orders = [list(order_of(Evaluation(setup=rcs.Setup(), episodes=20, seed=seed))) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]
    for order in orders:
        firsts = [letter for (_, letter) in order[::2]]
        assert all(sum(firsts[: 2 * pairs]) == pairs for pairs in range(11)), "each is first on one of every two seeds"
        assert sorted(order) == [(number, letter) for number in range(20) for letter in (0, 1)]


def test_no_name_is_anywhere_before_it_is_revealed_and_no_answer_is_lost(
    call: Any,
    caplog: pytest.LogCaptureFixture,
    addresses: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    # The third answer is corrected after the fourth episode, in which it is interrupted; the last one at the end.
    answers = itertools.chain(
        ["", "y", "n 1 #slip", "y"], ["u", "n", None], ["", "y", "y", "n", "y", "y"], ["u", "? #dark", ""]
    )

    def answer(_: str = "") -> str:
        if (word := next(answers)) is None:
            raise KeyboardInterrupt
        return word

    monkeypatch.setattr("builtins.input", answer)
    words = (
        "run", "--policy", addresses[0], "--blind", addresses[1], "--hardware", "fake", "--judge", "--task", "Free",
        "--frequency", "30", "--cameras", "none", "--episodes", "4", "--max-episode-steps", "5", "--out", str(out),
    )  # fmt: skip
    code, told = call(*words)
    assert code == 130
    assert len(Ledger(out).rows) == 3
    before = {row.agent for row in Ledger(out).rows.values()}
    code, more = call(*words)
    assert code == 0, more
    ledger = Ledger(out)
    assert [row.agent for row in ledger.rows.values()].count("X") == 4
    assert {row.agent for row in ledger.rows.values()} == {"X", "Y"} >= before
    rows = list(ledger.rows.values())
    assert [row.success for row in rows] == [True, False, False, True, True, False, True, None]
    assert [(row.failure, row.stages) for row in rows[:3]] == [(None, None), ("slip", 1), ("timeout", None)]
    assert [row.corrections for row in rows] == [0, 0, 1, 0, 0, 0, 0, 1]
    assert rows[-1].tags == ("dark",)
    assert len(ledger.conditions) == 2, "the second start knows the letters of the first"
    files = [path for path in out.rglob("*") if path.is_file()]
    assert {"report.html", "ledger.jsonl"} <= {path.name for path in files}
    for secret in (*NAMES, *addresses, *(address.rpartition(":")[2] for address in addresses)):
        for path in files:
            assert secret not in path.read_text(), path
        assert secret not in told + more + caplog.text
    assert not re.search(r"\b[XY]\b", told + more.partition("rcs unblind")[0]), "who judges sees no letter, either"
    (one,) = compare(ledger)
    assert {one.a, one.b} == {"X", "Y"}
    assert one.differences == {}

    code, told = call("unblind", str(out))
    assert code == 0, told
    assert all(name in told for name in NAMES)
    page = (out / "report.html").read_text()
    assert all(name in page for name in NAMES)
    ledger = Ledger(out)
    for name in NAMES:
        assert ledger.condition(ledger.find(name)).weights == f"{name}hash"
        assert ledger.condition(ledger.find(name)).data == f"{name}data"
        assert len(ledger.of(ledger.find(name))) == 4
    assert call("unblind", str(out))[0] == 0, "twice is harmless"


def test_recordings_have_the_keys_of_the_letters_and_no_name(
    call: Any, addresses: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, data, answers = tmp_path / "out", tmp_path / "data", iter(["", "y", "n", "?", "y"])
    monkeypatch.setattr("builtins.input", lambda _="": next(answers))
    words = (
        "run", "--policy", addresses[0], "--blind", addresses[1], "--hardware", "fake", "--judge", "--task", "Free",
        "--frequency", "30", "--cameras", "none", "--episodes", "2", "--max-episode-steps", "5",
    )  # fmt: skip
    code, told = call(*words, "--out", str(out), "--record", str(data))
    assert code == 0, told
    recorded = {episode.id.partition("-")[2]: episode.success for episode in Dataset.open(data).episodes}
    assert recorded == {row.key: row.success for row in Ledger(out).rows.values()}
    assert list(recorded.values()).count(True) == 2
    for path in [path for path in data.rglob("*") if path.is_file()]:
        assert not any(secret.encode() in path.read_bytes() for secret in (*NAMES, *addresses)), path


def test_a_policy_that_fails_is_not_named_in_the_log(
    call: Any, caplog: pytest.LogCaptureFixture, addresses: list[str], tmp_path: Path
) -> None:
    def fail(seen: Any, instruction: str) -> Any:
        raise ValueError("the weights of gammaray are broken")

    with Server(ScriptedPolicy(fail, replace(METADATA, name="gammaray")), port=0) as server:
        out, address = tmp_path / "out", str(server.address)
        words = ("--hardware", "fake", "--task", "Free", "--cameras", "none", "--max-episode-steps", "5")
        code, told = call("run", "--policy", addresses[0], "--blind", address, *words, "--episodes", "1",
                          "--frequency", "30", "--out", str(out))  # fmt: skip
    assert code == 0, told
    mine = [record.getMessage() for record in caplog.records if record.name.startswith("rcs.")]
    assert any("policy failed" in message for message in mine), "that one failed is told"
    for secret in ("gammaray", address, address.rpartition(":")[2]):
        assert all(secret not in message for message in mine)
        assert secret not in told
        assert all(secret not in path.read_text() for path in out.rglob("*") if path.is_file())


def test_a_policy_that_is_gone_is_not_named(
    call_unwrapped: Any, addresses: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.policy.agent.WAIT", 0.3)

    def act(seen: Any, instruction: str) -> Any:
        threading.Thread(target=server.close).start()
        return np.hstack([np.tile(seen.state["joints"], (8, 1)), np.ones((8, 1))])

    with Server(ScriptedPolicy(act, replace(METADATA, name="gammaray")), port=0) as server:
        address = str(server.address)
        words = ("--hardware", "fake", "--task", "Free", "--cameras", "none", "--max-episode-steps", "5")
        code, told = call_unwrapped("run", "--policy", addresses[0], "--blind", address, *words, "--episodes", "2",
                                    "--frequency", "30", "--out", tmp_path / "out")  # fmt: skip
    assert code == 1, told
    assert "A policy cannot be reached" in told
    for secret in ("gammaray", address, address.rpartition(":")[2]):
        assert secret not in told


def test_what_would_tell_the_names_is_refused(call: Any, addresses: list[str], tmp_path: Path) -> None:
    words = ("run", "--policy", addresses[0], "--hardware", "fake", "--task", "Free", "--cameras", "none")
    for more, sentence in [
        (("--blind", addresses[1], "--videos", "2"), "videos cannot be combined with blind"),
        (("--blind", addresses[1], "--name", "mine"), "name cannot be combined with blind"),
        (("--blind", addresses[0]), "nothing to compare"),
    ]:
        code, told = call(*words, *more, "--out", str(tmp_path / "out"))
        assert code == 1
        assert sentence in told
    assert not (tmp_path / "out" / "ledger.jsonl").exists()


class Terminal:
    """A program at a terminal of its own."""

    def __init__(self, *words: str) -> None:
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen([*RCS, *words], stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
        os.close(slave)
        self.told = ""

    def wait_for(self, words: str) -> None:
        """Wait until the program has printed something that matches since the last wait."""
        deadline, begun = time.monotonic() + 120, len(self.told)
        while not re.search(words, re.sub(r"\s+", " ", self.told[begun:])):
            assert time.monotonic() < deadline, self.told
            if select.select([self._master], [], [], 0.5)[0]:
                self.told += os.read(self._master, 65536).decode(errors="replace")

    def say(self, line: str) -> None:
        os.write(self._master, f"{line}\n".encode())

    def kill(self) -> None:
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        with contextlib.suppress(OSError):  # nobody has the other end any more
            while select.select([self._master], [], [], 0.5)[0] and (data := os.read(self._master, 65536)):
                self.told += data.decode(errors="replace")
        os.close(self._master)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="terminals of Linux")
def test_no_answer_is_lost_when_the_power_fails_right_after_it(addresses: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = (
        "run", "--policy", addresses[0], "--blind", addresses[1], "--hardware", "sim", "--judge", "--task",
        "PickCuboid", "--frequency", "30", "--cameras", "none", "--episodes", "2", "--max-episode-steps", "3",
        "--out", str(out),
    )  # fmt: skip
    answers, told, kept = ["n 1 #slip", "y", "?", "y 3 slowly"], "", 0
    pauses = iter([0.0, 0.01, 0.03, 0.1])  # after an answer; later ones are awaited
    while kept < len(answers):
        terminal, pause, promise = Terminal(*words), next(pauses, None), f"Episode {kept + 1} of 4"
        try:
            terminal.wait_for(r"Put the cuboid at x .*Then press Enter")
            terminal.say("")
            terminal.wait_for("Was the task done")
            terminal.say(answers[kept])
            if pause is None:
                terminal.wait_for(promise)
            else:
                time.sleep(pause)
        finally:
            terminal.kill()
            told += terminal.told
        found = len(Ledger(out).rows) if (out / "ledger.jsonl").exists() else 0
        assert found == kept + 1 or (found == kept and promise not in re.sub(r"\s+", " ", terminal.told))
        kept = found
    assert Ledger(out).damage == []
    rows = list(Ledger(out).rows.values())
    assert [(row.success, row.stages, row.tags, row.message) for row in rows] == [
        (False, 1, ("slip",), None), (True, None, (), None), (None, None, (), None), (True, 3, (), "slowly"),
    ]  # fmt: skip
    assert all(row.is_real for row in rows)
    firsts = [row.agent for row in rows[::2]]
    assert sorted(firsts) == ["X", "Y"], "each is first once"
    assert [row.agent for row in rows[1::2]] == firsts[::-1]
    for secret in (*NAMES, *addresses):
        assert secret not in told
        assert all(secret not in path.read_text() for path in out.rglob("*") if path.is_file())
