from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from vlagents import InvalidInput, Observation
from vlagents.cli.main import main
from vlagents.connect import connect
from vlagents.policies import catalogue
from vlagents.server import Server


def test_a_policy_is_served_until_a_signal_and_answers_ping_and_bench(capsys: pytest.CaptureFixture[str]) -> None:
    command = [sys.executable, "-m", "vlagents.cli", "serve", "random", "--checkpoint", "8", "--port", "0"]
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


def test_what_is_wrong_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "randum"]) == 1
    assert "Did you mean 'random'?" in capsys.readouterr().err
    assert main(["ping", "vla://127.0.0.1:1", "--timeout", "1"]) == 1
    assert "Nobody is at" in capsys.readouterr().err
    assert main(["serve", "random", "--host", "0.0.0.0"]) == 1
    assert "there is no token" in capsys.readouterr().err


@pytest.mark.parametrize("options", [(), ("--ws",), ("--wire", "openvla"), ("--wire", "gr00t")])
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


def test_a_hash_tells_checkpoints_apart(tmp_path: Path) -> None:
    for name, text in (("a", "1"), ("b", "1"), ("c", "2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "weights").write_text(text)
    a, b, c = (catalogue.hash_of(tmp_path / name) for name in "abc")
    assert a == b != c
    with pytest.raises(InvalidInput, match="number of values"):
        catalogue.load("random", "runs/a")
