from __future__ import annotations

import io
import time
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from vlagents import Chunk, ImageSpec, Metadata, Observation, PartSpec, Policy
from vlagents.other_wires.vla_eval import VlaEvalServer
from websockets.sync.client import ClientConnection, connect

METADATA = Metadata(
    name="counter",
    images=(ImageSpec("wrist"),),
    state=(PartSpec("states", 2),),
    action=(PartSpec("raw", 3),),
    horizon=2,
    rate=10.0,
)


class Counter(Policy):
    """Answers with a pixel, the sum of the state, and the length of the instruction; then with one more of each."""

    def __init__(self) -> None:
        self.resets: list[str] = []

    def metadata(self) -> Metadata:
        return METADATA

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.resets.append(instruction)

    def infer(self, observation: Observation) -> Chunk:
        image = observation.image("wrist")
        row = np.array([float(image[1, 2, 0]), observation.state["states"].sum(), float(len(observation.instruction))])
        return Chunk(np.array([row, row + 1]), 0.1)


@pytest.fixture
def server() -> Iterator[VlaEvalServer]:
    with VlaEvalServer(Counter(), port=0) as running:
        yield running


@pytest.fixture
def client(server: VlaEvalServer) -> Iterator[ClientConnection]:
    with connect(str(server.address)) as connection:
        yield connection


def send(client: ClientConnection, kind: str, payload: dict[str, Any], number: int = 1) -> None:
    client.send(msgpack.packb({"type": kind, "payload": payload, "seq": number, "timestamp": time.time()}))


def ask(client: ClientConnection, kind: str, payload: dict[str, Any], number: int = 1) -> dict[str, Any]:
    send(client, kind, payload, number)
    return msgpack.unpackb(client.recv(timeout=10), raw=False)


def array(values: Any, dtype: str = "<f4") -> dict[str, Any]:
    own = np.asarray(values, dtype)
    return {"__ndarray__": True, "data": own.tobytes(), "dtype": own.dtype.str, "shape": list(own.shape)}


def image(kind: str) -> dict[str, Any]:
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[1, 2] = 77
    if kind == "raw":
        return {"__image__": True, "format": "raw", **{k: v for k, v in array(pixels, "|u1").items() if k[0] != "_"}}
    pillow = pytest.importorskip("PIL.Image", reason="Pillow, which makes a PNG, is not installed")
    file = io.BytesIO()
    pillow.fromarray(pixels).save(file, format=kind.upper())
    return {"__image__": True, "format": kind, "data": file.getvalue(), "shape": [4, 6, 3]}


def observation(kind: str = "raw", **more: Any) -> dict[str, Any]:
    return {"images": {"wrist": image(kind)}, "states": array([1.0, 2.0]), "task_description": "stack", **more}


def rows(answer: dict[str, Any]) -> list[float]:
    found = answer["payload"]["actions"]
    assert (found["dtype"], found["shape"]) == ("<f4", [3])
    return np.frombuffer(found["data"], "<f4").tolist()


def test_hello_says_what_the_policy_needs(client: ClientConnection) -> None:
    answer = ask(client, "hello", {"harness_version": "0.8.0", "protocol_version": 1}, 5)
    assert (answer["type"], answer["seq"], answer["payload"]["protocol_version"]) == ("hello", 5, 1)
    assert answer["payload"]["observation_params"] == {"send_state": True, "send_wrist_image": True}
    assert answer["payload"]["model_server"] == "counter"


@pytest.mark.parametrize("kind", ["raw", "png"])
def test_every_observation_gets_the_next_row_until_the_episode_is_over(
    kind: str, client: ClientConnection, server: VlaEvalServer
) -> None:
    send(client, "episode_start", {"task": {"name": "stack"}})
    found = [ask(client, "observation", observation(kind), 7 + i) for i in range(3)]
    assert [(one["type"], one["seq"]) for one in found] == [("action", 7), ("action", 8), ("action", 9)]
    assert [rows(one) for one in found] == [[77.0, 3.0, 5.0], [78.0, 4.0, 6.0], [77.0, 3.0, 5.0]]
    send(client, "episode_end", {"metrics": {"success": True}})
    send(client, "episode_start", {"task": {"name": "again"}})
    assert rows(ask(client, "observation", observation()))[0] == 77.0, "the rest of the chunk is not of this episode"


def test_an_error_is_answered_and_the_connection_goes_on(client: ClientConnection) -> None:
    for payload, said in (({}, "no image 'wrist'"), ({"images": {"wrist": array([1.0])}}, "uint8 of shape")):
        answer = ask(client, "observation", payload, 3)
        assert (answer["type"], answer["seq"]) == ("error", 3)
        assert said in answer["payload"]["error"]
    assert "valid: hello" in ask(client, "dance", {})["payload"]["error"]
    assert rows(ask(client, "observation", observation()))[1] == 3.0


@pytest.mark.parametrize(
    "message",
    [
        b"\xc1",
        msgpack.packb({"type": "observation"}),
        msgpack.packb({"type": "observation", "payload": {"a": {"__ndarray__": True, "data": b"12", "dtype": "|O"}}}),
        msgpack.packb({"type": "observation", "payload": {"a": {"__image__": True, "format": "png", "data": b"12"}}}),
    ],
)
def test_what_is_no_message_ends_the_connection(message: bytes, server: VlaEvalServer) -> None:
    with connect(str(server.address)) as client:
        client.send(message)
        with pytest.raises(Exception, match=r"close|received"):
            client.recv(timeout=10)


def test_connections_have_sessions_of_their_own(server: VlaEvalServer) -> None:
    with connect(str(server.address)) as first, connect(str(server.address)) as second:
        assert rows(ask(first, "observation", observation()))[0] == 77.0
        assert rows(ask(second, "observation", observation()))[0] == 77.0
        assert rows(ask(first, "observation", observation()))[0] == 78.0
