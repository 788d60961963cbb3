from __future__ import annotations

import base64
import io
import json
import pickle
import re
import socket
import threading
import time
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from vlagents import (
    BadMessage,
    Chunk,
    ConnectionLost,
    DeadlineExceeded,
    ImageSpec,
    InvalidInput,
    Metadata,
    Observation,
    PartSpec,
    Policy,
    PolicyFailed,
    Unauthorized,
    connect,
)
from vlagents.other_wires import groot, openvla
from vlagents.other_wires.groot import GrootServer
from vlagents.other_wires.openvla import OpenvlaServer

METADATA = Metadata(name="echo", action=(PartSpec("arm", 2), PartSpec("gripper", 1)), horizon=2, rate=10.0)
IMAGE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
OBSERVATION = Observation({"image": IMAGE}, {"joints": np.arange(3.0)}, "pick", time=1.5, session="a")


class Echo(Policy):
    """Answers with a pixel, the state's sum and how long the instruction is."""

    def metadata(self) -> Metadata:
        return METADATA

    def infer(self, observation: Observation) -> Chunk:
        if observation.instruction == "fail":
            raise ZeroDivisionError("on purpose")
        if observation.instruction == "slow":
            time.sleep(1.0)
        total = sum(float(part.sum()) for part in observation.state.values())
        row = [float(observation.image("image")[3, 4, 1]), total, float(len(observation.instruction))]
        return Chunk(np.array([row, row]), 0.1)


@pytest.fixture(params=["gr00t", "openvla"])
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


def serve(kind: str, **options: Any) -> Any:
    return (GrootServer if kind == "gr00t" else OpenvlaServer)(Echo(), port=0, **options)


def test_our_client_gets_actions_from_our_server(kind: str) -> None:
    with serve(kind) as server, connect(str(server.address), metadata=METADATA) as client:
        client.reset("a", "place")
        chunk = client.infer(OBSERVATION)
        total = 3.0 if kind == "gr00t" else 0.0  # OpenVLA's wire has no state
        np.testing.assert_allclose(chunk.actions, [[float(IMAGE[3, 4, 1]), total, 4.0]] * 2)
        assert (chunk.period, chunk.time) == (0.1, 1.5)
        other = Observation(OBSERVATION.images, OBSERVATION.state, session="a")
        assert client.infer(other).actions[0, 2] == 5.0, "the instruction of the session's reset"


def test_what_fails_there_is_an_error_here_and_the_next_call_is_answered(kind: str) -> None:
    with serve(kind) as server, connect(str(server.address), metadata=METADATA) as client:
        with pytest.raises(PolicyFailed):
            client.infer(Observation(OBSERVATION.images, {}, "fail"))
        client.infer(OBSERVATION)


def test_a_late_answer_is_an_error_and_not_that_of_the_next_call(kind: str) -> None:
    with serve(kind) as server, connect(str(server.address), metadata=METADATA, timeout=0.4) as client:
        with pytest.raises(DeadlineExceeded):
            client.infer(Observation(OBSERVATION.images, {}, "slow"))
        time.sleep(1.0)
        if kind == "gr00t":  # its answers have no number: one that is late cannot be distinguished from the next
            with pytest.raises(ConnectionLost, match="`reset` connects again"):
                client.infer(OBSERVATION)
            client.reset()
        assert client.infer(OBSERVATION).actions[0, 2] == 4.0


def test_silence_is_late_and_nobody_is_an_error(kind: str) -> None:
    scheme = "gr00t" if kind == "gr00t" else "openvla+http"

    def call(port: int) -> None:
        with connect(f"{scheme}://127.0.0.1:{port}", period=0.1, timeout=0.3) as client:
            client.infer(OBSERVATION)

    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(DeadlineExceeded):
        call(silent.getsockname()[1])
    with pytest.raises((ConnectionLost, DeadlineExceeded)):
        call(1)


def test_without_the_token_nobody_gets_in(kind: str) -> None:
    with pytest.raises(InvalidInput, match="token"):
        serve(kind, host="0.0.0.0")
    with serve(kind, token="secret") as server:
        for wrong in (None, "secreT"):
            client = connect(str(server.address), metadata=METADATA, token=wrong)
            with client, pytest.raises((Unauthorized, PolicyFailed), match=r"token"):
                client.infer(OBSERVATION)
        with connect(str(server.address), metadata=METADATA, token="secret") as client:
            client.infer(OBSERVATION)


def test_a_client_needs_a_period_and_actions_of_the_size_that_it_knows(kind: str) -> None:
    wide = Metadata(name="wide", action=(PartSpec("arm", 9),), rate=10.0)
    with serve(kind) as server:
        with connect(str(server.address)) as client, pytest.raises(InvalidInput, match="give `period`"):
            client.infer(OBSERVATION)
        with connect(str(server.address), metadata=wide) as client, pytest.raises(BadMessage):
            client.infer(OBSERVATION)


@pytest.mark.extras
def test_gr00ts_layout_is_as_upstream_writes_it() -> None:
    import zmq

    def array(value: Any) -> Any:
        file = io.BytesIO()
        np.save(file, value, allow_pickle=False)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}

    seen = {"video": {"image": array(IMAGE[None, None])}, "state": {"joints": array(np.ones((1, 1, 3), np.float32))}}
    seen["language"] = {"task": [["pick"]]}
    with GrootServer(Echo(), port=0) as server, zmq.Context() as context, context.socket(zmq.REQ) as asks:
        asks.setsockopt(zmq.LINGER, 0)
        asks.connect(f"tcp://127.0.0.1:{server.address.port}")

        def ask(**request: Any) -> Any:
            asks.send(msgpack.packb(request))
            assert asks.poll(5000)
            return msgpack.unpackb(asks.recv())

        assert ask(endpoint="ping")["status"] == "ok"
        actions, _ = ask(endpoint="get_action", data={"observation": seen, "options": None})
        arm = np.load(io.BytesIO(actions["arm"]["as_npy"]), allow_pickle=False)
        assert arm.shape == (1, 2, 2)
        assert arm.dtype == np.float32
        assert arm[0, 0].tolist() == [float(IMAGE[3, 4, 1]), 3.0]
        assert "no endpoint" in ask(endpoint="kill")["error"]
        assert ask(endpoint="ping")["status"] == "ok"


def test_every_endpoint_of_gr00t_that_the_page_names_is_answered() -> None:
    page = (Path(__file__).parents[4] / "docs" / "wires.md").read_text()
    heading, *named = re.findall(r"^\| `(\w+)` \|", page.split("\n## GR00T\n")[1].split("\n## ")[0], re.MULTILINE)
    assert (heading, named) == ("endpoint", ["ping", "reset", "get_action"])
    with serve("gr00t") as server, connect(str(server.address), metadata=METADATA) as client:
        for name in named[:2]:
            client._call(name, None)
        with pytest.raises(PolicyFailed, match="image"):
            client._call("get_action", {"observation": {}})
        with pytest.raises(PolicyFailed, match="valid: get_action, reset, ping"):
            client._call("get_modality_config", None)


def test_openvlas_layout_is_as_upstream_writes_it() -> None:
    image = {"__numpy__": base64.b64encode(IMAGE.tobytes()).decode(), "dtype": "|u1", "shape": [24, 32, 3]}
    request = {"image": image, "instruction": "pick"}
    with OpenvlaServer(Echo(), port=0) as server:

        def post(data: Any) -> Any:
            url = f"http://127.0.0.1:{server.address.port}/act"
            asked = urllib.request.Request(url, json.dumps(data).encode(), {"Content-Type": "application/json"})
            return json.loads(urllib.request.urlopen(asked, timeout=5.0).read())

        plain = post(request)
        assert np.frombuffer(base64.b64decode(plain["__numpy__"])).tolist()[2] == 4.0
        assert json.loads(post({"encoded": json.dumps(request)})) == plain
        assert post({"image": image}) == "error"


def test_the_image_of_a_request_has_the_name_that_the_policy_knows() -> None:
    class Seeing(Echo):
        def metadata(self) -> Metadata:
            return replace(METADATA, images=(ImageSpec("wrist"),))

        def infer(self, observation: Observation) -> Chunk:
            return Chunk(np.full((1, 3), observation.image("wrist").mean()), 0.1)

    with OpenvlaServer(Seeing(), port=0) as server, connect(str(server.address), metadata=METADATA) as client:
        image = np.full((4, 4, 3), 7, np.uint8)
        assert client.infer(Observation({"any": image}, {}, "pick")).actions.tolist() == [[7.0] * 3]


def test_files_of_objects_are_refused_and_never_loaded(tmp_path: Path) -> None:
    class Canary:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "canary",))

    file = io.BytesIO()
    np.save(file, np.array([Canary()], object), allow_pickle=True)
    with pytest.raises(BadMessage):
        groot.array_from_npy(file.getvalue())
    with pytest.raises(BadMessage):
        groot.unpack(msgpack.packb({"__ndarray_class__": True, "as_npy": pickle.dumps(Canary())}))
    with pytest.raises(BadMessage):
        openvla.from_json(b'{"__numpy__": "AAAA", "dtype": "|O", "shape": [1]}')
    assert not (tmp_path / "canary").exists()


@pytest.mark.parametrize("shape", [(2**40,), (1 << 20, 1 << 20), (4,), (2,)])
def test_an_array_that_is_said_to_be_larger_than_it_is_is_refused_before_memory_is_taken(shape: Any) -> None:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with pytest.raises(BadMessage):
        groot.array_from_npy(file.getvalue() + bytes(24))
    said = {"__numpy__": base64.b64encode(bytes(24)).decode(), "dtype": "<f8", "shape": list(shape)}
    with pytest.raises(BadMessage):
        openvla.from_json(json.dumps(said).encode())


def test_an_openvla_server_that_drips_is_late_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def act() -> None:
            connection, _ = listener.accept()
            with connection:
                try:
                    for _ in range(100):
                        connection.sendall(b"H")
                        time.sleep(0.05)
                except OSError:
                    pass

        threading.Thread(target=act, daemon=True).start()
        begin = time.monotonic()
        client = connect(f"openvla+http://127.0.0.1:{listener.getsockname()[1]}", period=0.1, timeout=0.5)
        with client, pytest.raises(DeadlineExceeded):
            client.infer(OBSERVATION)
        assert time.monotonic() - begin < 3.0


@pytest.mark.parametrize("answer", [b"", b"x", b'"no"', b"{}", b'{"__numpy__": 5}', b"[" * 100_000])
def test_garbage_of_an_openvla_server_is_a_typed_error(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def act() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(1 << 20)
                connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(answer) + answer)

        thread = threading.Thread(target=act, daemon=True)
        thread.start()
        client = connect(f"openvla+http://127.0.0.1:{listener.getsockname()[1]}", period=0.1, timeout=2.0)
        with client, pytest.raises((BadMessage, ConnectionLost, PolicyFailed)):
            client.infer(OBSERVATION)
        thread.join()


@pytest.mark.parametrize("request_", [b"[]", b"{}", b'{"instruction": 3}'])
def test_a_request_of_openvla_without_an_instruction_is_refused_in_words(
    request_: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with OpenvlaServer(Echo(), port=0) as server:
        call = urllib.request.Request(f"http://127.0.0.1:{server.address.port}/act", request_)
        with urllib.request.urlopen(call, timeout=5.0) as answer:
            assert answer.read() == b'"error"'
    assert "A request has no instruction." in caplog.text


def test_a_body_that_trickles_is_late_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer() -> None:
            peer, _ = listening.accept()
            with peer:
                peer.sendall(b"HTTP/1.0 200 OK\r\nContent-Length: 40\r\n\r\n")
                for _ in range(20):
                    try:
                        peer.sendall(b" ")
                    except OSError:
                        return
                    time.sleep(0.2)

        threading.Thread(target=answer, daemon=True).start()
        address = f"openvla+http://127.0.0.1:{listening.getsockname()[1]}"
        with connect(address, metadata=METADATA, timeout=0.5) as client:
            begin = time.monotonic()
            with pytest.raises(DeadlineExceeded):
                client.infer(OBSERVATION)
            assert time.monotonic() - begin < 2.0
