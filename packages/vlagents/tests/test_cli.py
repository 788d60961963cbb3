from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from vlagents import InvalidInput, Observation, Server, VlagentsError, connect
from vlagents.cli.main import main
from vlagents.policies import catalogue


def test_a_policy_is_served_until_a_signal_and_answers_ping_and_bench(capsys: pytest.CaptureFixture[str]) -> None:
    command = [sys.executable, "-m", "vlagents.cli", "serve", "random", "--size", "8", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as serving:
        assert serving.stdout is not None
        address = serving.stdout.readline().split(" at ")[1].split(". ")[0]
        assert main(["ping", address]) == 0
        assert "joints: 8" in capsys.readouterr().out
        assert main(["bench", address, "--calls", "5", "--image", "32x48"]) == 0
        assert json.loads(capsys.readouterr().out)["calls"] == 5
        serving.send_signal(signal.SIGTERM)
        assert serving.wait(10.0) == 0


def test_a_policy_is_served_to_openvlas_clients_too() -> None:
    command = [sys.executable, "-m", "vlagents.cli", "serve", "random", "--port", "0", "--wire", "openvla"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as serving:
        assert serving.stdout is not None
        address = serving.stdout.readline().split(" at ")[1].split(". ")[0]
        with connect(address, period=0.1) as client:
            image = np.zeros((8, 8, 3), np.uint8)
            assert client.infer(Observation({"side": image}, instruction="pick")).actions.shape == (1, 7)
        serving.send_signal(signal.SIGTERM)
        assert serving.wait(10.0) == 0


OWN = """
import sys, threading, time
import numpy as np
from vlagents import Chunk, Metadata, PartSpec, Policy
class Mine(Policy):
    def __init__(self, checkpoint: str = "", *, horizon: int = 1, scale=(1.0,), name: str = "mine"):
        self.given = Metadata(name=name, action=(PartSpec("a", len(scale)),), horizon=horizon, rate=10.0)
        self.scale = scale
        if checkpoint == "keeps a thread":
            threading.Thread(target=threading.Event().wait).start()
    def metadata(self):
        return self.given
    def infer(self, observation):
        if observation.instruction == "hang":
            print("hangs", flush=True)
            while True:
                time.sleep(0.1)
        return Chunk(np.tile(np.array(self.scale), (self.given.horizon, 1)), 0.1)
"""
"""A policy of one's own, in a file of the current folder."""


def serving(folder: Path, *words: str) -> subprocess.Popen[str]:
    (folder / "own.py").write_text(OWN)
    command = [sys.executable, "-m", "vlagents.cli", "serve", "own:Mine", "--port", "0", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)


def test_a_class_of_ones_own_is_served_with_its_options(tmp_path: Path) -> None:
    with serving(tmp_path, "--horizon", "3", "--scale=[1, -2.5]", "--name", "7") as served:
        assert served.stdout is not None
        first = served.stdout.readline()
        assert first.startswith("Serving 7 at ")
        with connect(first.split(" at ")[1].split(". ")[0]) as client:
            assert client.infer(Observation()).actions.tolist() == [[1.0, -2.5]] * 3
        served.send_signal(signal.SIGTERM)
        assert served.wait(10.0) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("own:Mine", "--horizn", "3"), "valid: --checkpoint, --horizon, --scale, --name. Did you mean '--horizon'?"),
        (("own:Mine", "--horizon"), "--name value"),
        (("own:Yours",), "valid is module:Class"),
        (("missing:Mine",), "valid is module:Class"),
        (("own:",), "valid is module:Class"),
        (("own:__name__",), "is str; valid is module:Class"),
        (("json:loads", "--checkpoint", "5"), "valid is a vlagents.Policy"),
        (("json:loads",), "cannot be made"),
        (("random", "--sise", "3"), "has no option --sise"),
    ],
)
def test_a_class_or_an_option_that_is_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: Sequence[str], told: str
) -> None:
    (tmp_path / "own.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert main(["serve", *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: InvalidInput:")
    assert told in line


@pytest.mark.parametrize(
    ("options", "number"),
    [
        ((), signal.SIGINT),
        (("--wire", "ws"), signal.SIGTERM),
        (("--wire", "openvla"), signal.SIGTERM),
        (("--wire", "gr00t"), signal.SIGINT),
    ],
)
def test_a_policy_that_hangs_does_not_keep_its_server_from_ending(
    tmp_path: Path, options: Sequence[str], number: signal.Signals
) -> None:
    with serving(tmp_path, "--checkpoint", "keeps a thread", *options) as served:
        assert served.stdout is not None
        assert served.stderr is not None
        address = served.stdout.readline().split(" at ")[1].split(". ")[0]
        asks = connect(address, timeout=20.0, period=0.1)
        lost: list[VlagentsError] = []

        def ask() -> None:
            try:
                asks.infer(Observation({"image": np.zeros((4, 4, 3), np.uint8)}, instruction="hang"))
            except VlagentsError as error:
                lost.append(error)

        asking = threading.Thread(target=ask)
        asking.start()
        assert served.stdout.readline() == "hangs\n"
        served.send_signal(number)
        try:
            assert served.wait(10.0) == 1
        finally:
            served.kill()
        assert "still works on a call" in served.stderr.read()
        asking.join(10.0)
        assert len(lost) == 1


def test_what_is_wrong_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "randum"]) == 1
    assert "Did you mean 'random'?" in capsys.readouterr().err
    assert main(["ping", "vla://127.0.0.1:1", "--timeout", "1"]) == 1
    assert "No server is at" in capsys.readouterr().err
    assert main(["serve", "random", "--host", "0.0.0.0"]) == 1
    assert "there is no token" in capsys.readouterr().err


@pytest.mark.parametrize("options", [(), ("--wire", "ws"), ("--wire", "openvla"), ("--wire", "gr00t")])
def test_a_port_that_is_taken_is_named(options: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert main(["serve", "random", "--port", str(port), *options]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: AddressTaken:")
    assert f"127.0.0.1:{port}" in line
    assert "--port" in line


def test_the_token_comes_from_a_file_or_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "token").write_text("secret\n")
    with Server(catalogue.load("random"), port=0, token="secret") as server:
        assert main(["ping", str(server.address)]) == 1
        assert "Unauthorized" in capsys.readouterr().err
        assert main(["ping", str(server.address), "--token-file", str(tmp_path / "token")]) == 0
        monkeypatch.setenv("VLAGENTS_TOKEN", "secret")
        assert main(["ping", str(server.address)]) == 0


def test_a_function_that_makes_a_policy_is_served_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scripts.py").write_text(
        "from vlagents import Metadata, PartSpec\n"
        "from vlagents.policies.scripted import ScriptedPolicy\n"
        "def nod():\n"
        "    return ScriptedPolicy(lambda seen, told: [1.0], Metadata('nod', (PartSpec('joints', 1),), rate=5.0))\n"
        "def number():\n"
        "    return 3\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert catalogue.load("scripts:nod").infer(Observation()).actions.tolist() == [[1.0]]
    with pytest.raises(InvalidInput, match=r"made int; valid is a vlagents\.Policy"):
        catalogue.load("scripts:number")


def test_a_hash_tells_checkpoints_apart(tmp_path: Path) -> None:
    for name, text in (("a", "1"), ("b", "1"), ("c", "2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "weights").write_text(text)
    a, b, c = (catalogue.hash_of(tmp_path / name) for name in "abc")
    assert a == b != c
    with pytest.raises(InvalidInput, match="cannot be made"):
        catalogue.load("random", "runs/a")
