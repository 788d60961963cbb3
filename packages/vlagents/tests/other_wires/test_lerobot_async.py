"""LeRobot's asynchronous wire: a server with its messages, which unpickles as LeRobot's does, and our client."""

from __future__ import annotations

import os
import pickle
import socket
import sys
import time
from collections.abc import Iterator
from concurrent import futures
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from vlagents import (
    BadMessage,
    ConnectionLost,
    DeadlineExceeded,
    ImageSpec,
    InvalidInput,
    Metadata,
    Observation,
    PartSpec,
    PolicyFailed,
)
from vlagents.connect import connect
from vlagents.other_wires import lerobot_async
from vlagents.other_wires.lerobot_async import CVE, field, only_field

JOINTS = PartSpec("joints", 2, "rad")
METADATA = Metadata(
    name="act", images=(ImageSpec("wrist", 8, 16),), state=(JOINTS,), action=(JOINTS,), horizon=3, rate=10.0
)
IMAGE = np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8)
OBSERVATION = Observation({"wrist": IMAGE}, {"joints": np.array([0.5, -0.25])}, "pick", time=1.5)
GIVEN: dict[str, Any] = {"policy": "act", "checkpoint": "/there", "metadata": METADATA, "accepts": CVE}


class Kept:
    """Takes the place of LeRobot's classes."""

    timestep: int
    observation: dict[str, Any]


@pytest.fixture
def classes(monkeypatch: pytest.MonkeyPatch) -> Any:
    """LeRobot's module with classes that only keep what they are told."""
    helpers: Any = ModuleType("lerobot.async_inference.helpers")
    for name in ("RemotePolicyConfig", "TimedObservation", "TimedAction"):
        setattr(helpers, name, type(name, (Kept,), {"__module__": helpers.__name__}))
    for name in ("lerobot", "lerobot.async_inference"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, helpers.__name__, helpers)
    return helpers


class StandIn:
    """A server with LeRobot's four calls."""

    def __init__(self, grpc: Any, classes: Any) -> None:
        self.grpc, self.classes = grpc, classes
        self.instructions: list[Any] = []
        self.pieces: list[bytes] = []
        self.readies = 0
        self.seen: Any = None
        self.answer = self.chunk
        self.server = grpc.server(futures.ThreadPoolExecutor(4))
        unary, stream = grpc.unary_unary_rpc_method_handler, grpc.stream_unary_rpc_method_handler
        handlers = {
            "Ready": unary(self._ready),
            "SendPolicyInstructions": unary(self._load),
            "SendObservations": stream(self._see),
            "GetActions": unary(lambda _, context: self.answer()),
        }
        self.server.add_generic_rpc_handlers(
            (grpc.method_handlers_generic_handler("transport.AsyncInference", handlers),)
        )
        port = self.server.add_insecure_port("127.0.0.1:0")
        self.address = f"lerobot+grpc://127.0.0.1:{port}"
        self.server.start()

    def _ready(self, request: bytes, context: Any) -> bytes:
        self.readies += 1
        return b""

    def _load(self, request: bytes, context: Any) -> bytes:
        self.instructions.append(pickle.loads(only_field(request)))
        if self.instructions[-1].pretrained_name_or_path == "/nowhere":
            raise FileNotFoundError("there is no checkpoint")
        return b""

    def _see(self, requests: Iterator[bytes], context: Any) -> bytes:
        self.pieces = list(requests)
        data = b"".join(only_field(b"\x0a" + piece[3:]) for piece in self.pieces)
        self.seen = pickle.loads(data)
        return b""

    def chunk(self, first: int = 0) -> bytes:
        import torch

        raw = self.seen.observation
        row = [raw["joints.0"], raw["joints.1"] + float(raw["wrist"][3, 4, 1])]
        timed = []
        for i, action in enumerate(torch.tensor([row] * 3)):
            one = self.classes.TimedAction()
            one.__dict__ |= {"timestamp": 0.0, "timestep": self.seen.timestep + first + i, "action": action}
            timed.append(one)
        return field(1, pickle.dumps(timed))


@pytest.fixture
def server(classes: Any) -> Iterator[StandIn]:
    pytest.importorskip("torch")  # takes longer than an answer may
    made = StandIn(pytest.importorskip("grpc"), classes)
    yield made
    made.server.stop(None).wait()


@pytest.mark.parametrize("accepts", ["", "yes", True])
def test_whoever_does_not_name_the_hole_does_not_ask(accepts: Any) -> None:
    with pytest.raises(InvalidInput, match="CVE-2026-25874"):
        connect("lerobot+grpc://127.0.0.1:8080", **GIVEN | {"accepts": accepts})


UNSIZED = Metadata(name="a", images=(ImageSpec("w"),), state=(JOINTS,), action=(JOINTS,), rate=1.0)


@pytest.mark.parametrize(
    "wrong",
    [{"policy": ""}, {"checkpoint": ""}, {"metadata": None, "period": 0.1}, {"token": "x"}, {"metadata": UNSIZED}],
)
def test_what_the_server_has_to_be_told_is_asked_for(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput):
        connect("lerobot+grpc://127.0.0.1:8080", **GIVEN | wrong)


@pytest.mark.parametrize("size", [0, 1, 127, 128, 16383, 16384, 3_000_000])
def test_a_field_is_read_as_it_was_written(size: int) -> None:
    assert only_field(field(1, b"x" * size)) == b"x" * size


@pytest.mark.parametrize(
    "message", [b"\x0a", b"\x0a\x02x", b"\x12\x01x", b"\x0a\x01xy", b"\x0a" + b"\xff" * 12, b"\x08\x01"]
)
def test_another_message_is_refused(message: bytes) -> None:
    with pytest.raises(BadMessage):
        only_field(message)


@pytest.mark.extras
def test_the_server_gets_what_lerobot_reads_and_its_chunk_arrives(server: StandIn) -> None:
    with connect(server.address, **GIVEN) as client:
        client.reset("a", "place")
        chunk = client.infer(OBSERVATION)
        np.testing.assert_allclose(chunk.actions, [[0.5, -0.25 + float(IMAGE[3, 4, 1])]] * 3)
        assert (chunk.period, chunk.time) == (0.1, 1.5)
        assert server.seen.observation["task"] == "pick"
        np.testing.assert_array_equal(server.seen.observation["wrist"], IMAGE)
        client.infer(Observation(OBSERVATION.images, OBSERVATION.state, session="a"))
        assert (server.seen.observation["task"], server.seen.timestep, server.seen.must_go) == ("place", 2, True)
    (told,) = server.instructions
    assert (server.readies, told.policy_type, told.pretrained_name_or_path, told.actions_per_chunk) == (
        1, "act", "/there", 3,
    )  # fmt: skip
    assert told.lerobot_features["observation.state"]["names"] == ["joints.0", "joints.1"]
    assert told.lerobot_features["observation.images.wrist"]["shape"] == (8, 16, 3)


@pytest.mark.extras
def test_a_large_picture_goes_in_pieces(server: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lerobot_async, "PIECE", 100)
    with connect(server.address, **GIVEN) as client:
        client.infer(OBSERVATION)
    assert [piece[1] for piece in server.pieces] == [1, *[2] * (len(server.pieces) - 2), 3]
    np.testing.assert_array_equal(server.seen.observation["wrist"], IMAGE)


class Canary:
    """Leaves a folder behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.extras
def test_a_server_that_sends_code_is_not_obeyed(server: StandIn, tmp_path: Path) -> None:
    server.answer = lambda: field(1, pickle.dumps([Canary(tmp_path / "ran")]))
    with connect(server.address, **GIVEN) as client:
        with pytest.raises(BadMessage, match="mkdir"):
            client.infer(OBSERVATION)
        assert not (tmp_path / "ran").exists()
        server.answer = server.chunk
        client.infer(OBSERVATION)


@pytest.mark.extras
def test_what_goes_wrong_there_is_a_typed_error_here(server: StandIn) -> None:
    for answer, error in [
        (lambda: b"", PolicyFailed),
        (lambda: 1 / 0, PolicyFailed),
        (lambda: b"\xff\xff", BadMessage),
        (lambda: field(1, pickle.dumps("text")), BadMessage),
        (lambda: field(1, pickle.dumps([])), BadMessage),
        (lambda: server.chunk(first=7), BadMessage),
        (lambda: field(1, b"x" * (33 << 20)), BadMessage),
    ]:
        server.answer = answer  # type: ignore[assignment]
        with connect(server.address, **GIVEN) as client:
            with pytest.raises(error):
                client.infer(OBSERVATION)
            server.answer = server.chunk
            assert client.infer(OBSERVATION).actions.shape == (3, 2)
    lost = pytest.raises(PolicyFailed, match="no checkpoint")
    with connect(server.address, **GIVEN | {"checkpoint": "/nowhere"}) as client, lost:
        client.reset()


@pytest.mark.extras
def test_a_late_answer_is_an_error_and_the_next_one_is_of_its_own_observation(server: StandIn) -> None:
    with connect(server.address, timeout=0.4, **GIVEN) as client:
        client.infer(OBSERVATION)
        server.answer = lambda: time.sleep(1.0) or server.chunk()
        with pytest.raises(DeadlineExceeded):
            client.infer(OBSERVATION)
        server.answer = server.chunk
        client.infer(OBSERVATION)
        assert server.readies == 2


@pytest.mark.extras
def test_silence_is_late_and_nobody_is_an_error(server: StandIn) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        client = connect(f"lerobot+grpc://127.0.0.1:{silent.getsockname()[1]}", timeout=0.3, **GIVEN)
        begin = time.monotonic()
        with client, pytest.raises(DeadlineExceeded):
            client.infer(OBSERVATION)
        assert time.monotonic() - begin < 3.0
    with connect("lerobot+grpc://127.0.0.1:1", timeout=1.0, **GIVEN) as client, pytest.raises(ConnectionLost):
        client.reset()
    with connect(server.address, timeout=2.0, **GIVEN) as client:
        client.infer(OBSERVATION)
        server.server.stop(None).wait()
        with pytest.raises(ConnectionLost):
            client.infer(OBSERVATION)
