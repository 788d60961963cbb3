"""Faults of a wire: every outcome is a typed error here, and nobody else notices."""

from __future__ import annotations

import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import msgpack
from vlagents import BadMessage, Client, ConnectionLost, DeadlineExceeded, Observation, Server, VlagentsError
from vlagents.policies.random import RandomPolicy
from vlagents.websocket import WebsocketClient, WebsocketServer
from vlagents.wire.link import Deadline, Link
from vlagents.wire.stream import PREFIX, StreamChannel
from vlagents.wire_server import Guest

SERVE = """
import sys, time
import numpy as np
from vlagents import Chunk, Metadata, PartSpec, Policy
from vlagents import Server
from vlagents.websocket import WebsocketServer
class Slow(Policy):
    def metadata(self):
        return Metadata(name="slow", action=(PartSpec("joints", 1),), rate=10.0)
    def infer(self, observation):
        time.sleep(float(observation.state["wait"][0]))
        return Chunk(np.zeros((1, 1)), 0.1)
server = (WebsocketServer if sys.argv[1] == "websocket" else Server)(Slow(), port=0).start()
print(server.address, flush=True)
time.sleep(60)
"""
ASK = """
import sys, time
import numpy as np
from vlagents import Observation
from vlagents import connect
client = connect(sys.argv[1], **({} if sys.argv[2] == "websocket" else {"is_shared": sys.argv[2] == "shared"}))
client.reset("left", "pick")
image = np.zeros((720, 1280, 3), np.uint8)
print("ready", flush=True)
while True:
    client.infer(Observation(images={"side": image}, session="left"))
"""


def named_memory() -> set[str]:
    """Return the names of shared memory on this machine; semaphores and arrays of other programs come and go."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith(("sem.", "pym-"))}


def process(code: str, *words: str) -> Any:
    return subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True)


def wait(seconds: float) -> Observation:
    return Observation(images={"side": np.zeros((480, 640, 3), np.uint8)}, state={"wait": np.array([seconds])})


def connect(kind: str, address: str, **options: Any) -> Any:
    if kind == "websocket":
        return WebsocketClient(address, **options)
    return Client(address, is_shared=kind == "shared", **options)


@pytest.mark.parametrize("kind", ["shared", "tcp", "websocket"])
def test_a_server_that_is_killed_in_the_middle_is_lost_at_once(kind: str) -> None:
    before = named_memory()
    served = process(SERVE, kind)
    client = connect(kind, served.stdout.readline().strip(), timeout=20.0)
    client.infer(wait(0.0))
    threading.Timer(0.3, served.kill).start()
    begin = time.monotonic()
    with pytest.raises(ConnectionLost):
        client.infer(wait(15.0))
    assert time.monotonic() - begin < 5.0
    with pytest.raises(ConnectionLost):
        client.infer(wait(0.0))
    served.wait()
    client.close()
    assert named_memory() == before


@pytest.mark.parametrize("kind", ["shared", "tcp", "websocket"])
def test_a_client_that_is_killed_leaves_nothing_and_touches_nobody(kind: str, observation: Observation) -> None:
    before = named_memory()
    make: Any = WebsocketServer if kind == "websocket" else Server
    with make(RandomPolicy(size=8), port=0) as server, connect(kind, str(server.address)) as stays:
        stays.reset("left", "pick", seed=0)
        for _ in range(3):
            asking = process(ASK, str(server.address), kind)
            assert asking.stdout.readline() == "ready\n"
            time.sleep(0.1)
            asking.send_signal(signal.SIGKILL)
            asking.wait()
            stays.infer(observation)
        assert named_memory() == before
        deadline = time.monotonic() + 5.0
        while len(server.channels) > 1 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert len(server.channels) == 1


@pytest.mark.parametrize("kind", ["shared", "tcp", "websocket"])
def test_a_server_that_stands_still_is_late_and_its_late_answer_answers_nothing_else(kind: str) -> None:
    served = process(SERVE, kind)
    client = connect(kind, served.stdout.readline().strip(), timeout=20.0)
    client.infer(wait(0.0))
    client.timeout = 0.5
    served.send_signal(signal.SIGSTOP)
    os.waitpid(served.pid, os.WUNTRACED)  # from here, it is as if somebody had pulled the cable
    begin = time.monotonic()
    with pytest.raises(DeadlineExceeded):
        client.infer(wait(0.0))
    assert time.monotonic() - begin < 5.0
    served.send_signal(signal.SIGCONT)
    client.timeout = 20.0
    if kind == "websocket":  # openpi's answers have no number, so that one is lost with its connection
        with pytest.raises(ConnectionLost):
            client.infer(wait(0.0))
        client.reset()
    moment = Observation(state={"wait": np.zeros(1)}, time=7.5)
    assert client.infer(moment).time == 7.5
    client.close()
    served.kill()
    served.wait()


@pytest.mark.parametrize("kind", ["tcp", "websocket"])
def test_whoever_has_gone_without_a_word_is_looked_for_by_both_sides(kind: str) -> None:
    make: Any = WebsocketServer if kind == "websocket" else Server
    with make(RandomPolicy(size=8), port=0) as server, connect(kind, str(server.address)) as client:
        for channel in (client._channel, *server.channels):
            assert channel._link._socket.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to become somebody else")
def test_somebody_else_gets_no_shared_memory(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "socket"
    code = (
        "import os, socket, sys; os.setuid(65534); s = socket.socket(socket.AF_UNIX); s.connect(sys.argv[1]); s.recv(1)"
    )
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        for place in (path, *list(path.parents)[:-1]):
            if place.stat().st_uid == 0 and place != Path("/tmp"):
                place.chmod(0o777)
        listening.listen(1)
        listening.settimeout(10.0)
        other = process(code, str(path))
        connection, _ = listening.accept()
        with connection:
            server = Server(RandomPolicy(size=8), port=0)
            server._answer_guest(Guest(name="somebody", connection=connection), server._open_beside)
        assert "another user" in caplog.text
    other.wait()


def test_a_websocket_client_that_does_not_read_ends_its_connection_and_nothing_else() -> None:
    policy = RandomPolicy(size=8, horizon=20_000)
    with WebsocketServer(policy, port=0, transfer=0.5) as server, WebsocketClient(str(server.address)) as stays:
        evil = WebsocketClient(str(server.address))

        def ask_and_never_read() -> None:
            assert evil._channel is not None
            call: Any = msgpack.encode({"prompt": "x"})
            for _ in range(10_000):  # 1 MB each comes back
                evil._channel.send([call], Deadline(5.0, "reading"))
                time.sleep(0.001)

        with pytest.raises(VlagentsError):
            ask_and_never_read()
        evil.close()
        stays.infer(Observation())


@pytest.fixture
def listener() -> Any:
    """A port that takes connections and never says anything."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


@pytest.mark.parametrize("kind", ["tcp", "websocket"])
def test_a_server_that_says_nothing_is_late(listener: socket.socket, kind: str) -> None:
    host, port = listener.getsockname()
    scheme = "ws" if kind == "websocket" else "vla"
    begin = time.monotonic()
    with pytest.raises(DeadlineExceeded):
        connect(kind, f"{scheme}://{host}:{port}", timeout=0.3)
    assert time.monotonic() - begin < 3.0


def answering(listener: socket.socket, data: bytes, *, then_close: bool) -> None:
    """Send some bytes to whoever connects."""

    def act() -> None:
        connection, _ = listener.accept()
        connection.recv(1 << 16)
        connection.sendall(data)
        if then_close:
            connection.close()
        else:
            time.sleep(2.0)

    threading.Thread(target=act, daemon=True).start()


@pytest.mark.parametrize(
    ("data", "then_close", "error"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", True, BadMessage),
        (b"VLA1" + struct.pack("<IQ", 10, 2**63), False, BadMessage),
        (b"VLA1" + struct.pack("<IQ", 2**32 - 1, 0), False, BadMessage),
        (b"VLA1" + struct.pack("<IQ", 100, 0) + b"short", True, ConnectionLost),
        (b"VLA1" + struct.pack("<IQ", 100, 0) + b"short", False, DeadlineExceeded),
        (PREFIX.pack(b"VLA1", 3, 0) + b"\xc1\xc1\xc1", False, BadMessage),
        (PREFIX.pack(b"VLA1", 1, 0) + b"\xc0", False, BadMessage),
        (b"", True, ConnectionLost),
    ],
)
def test_a_server_that_sends_garbage_is_a_typed_error(
    listener: socket.socket, data: bytes, then_close: bool, error: type[VlagentsError]
) -> None:
    answering(listener, data, then_close=then_close)
    host, port = listener.getsockname()
    with pytest.raises(error):
        Client(f"vla://{host}:{port}", timeout=0.5)


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"VLA1" + struct.pack("<IQ", 10, 2**63),
        b"VLA1" + struct.pack("<IQ", 10, 100_000_000),  # before hello, that much is refused
        PREFIX.pack(b"VLA1", 4, 0) + b"\xdf\xff\xff\xff",
        PREFIX.pack(b"VLA1", 50_000, 0) + b"\x91" * 50_000,
        b"\x00" * 1000,
    ],
)
def test_a_client_that_sends_garbage_is_cut_off_and_others_are_served(
    server: Server, observation: Observation, data: bytes
) -> None:
    with Client(str(server.address), is_shared=False) as stays:
        with socket.create_connection((server.address.host, server.address.port), timeout=5.0) as evil:
            evil.sendall(data)
            while evil.recv(1 << 16):  # an answer that says why, then the end
                pass
        assert stays.infer(observation).actions.shape == (4, 8)


def test_calls_before_hello_are_refused(server: Server) -> None:
    channel = StreamChannel(Link(socket.create_connection((server.address.host, server.address.port))))
    soon = Deadline(5.0, "an answer")
    channel.send({"call": "ping", "id": 1}, soon)
    assert channel.receive(soon)["error"]["kind"] == "unauthorized"
    with pytest.raises(ConnectionLost):
        channel.receive(soon)


def test_a_half_sent_message_ends_the_connection_and_nothing_else(observation: Observation) -> None:
    with Server(RandomPolicy(size=8), port=0, transfer=0.3) as server, Client(str(server.address)) as stays:
        with socket.create_connection((server.address.host, server.address.port), timeout=5.0) as slow:
            slow.sendall(b"VLA1" + struct.pack("<IQ", 100, 0) + b"sh")
            begin = time.monotonic()
            while slow.recv(1 << 16):
                pass
            assert 0.2 < time.monotonic() - begin < 3.0
        stays.infer(observation)


def test_a_client_that_does_not_read_ends_its_connection_and_nothing_else(observation: Observation) -> None:
    policy = RandomPolicy(size=8, horizon=20_000)
    with Server(policy, port=0, transfer=0.5) as server, Client(str(server.address)) as stays:
        channel = StreamChannel(Link(socket.create_connection((server.address.host, server.address.port))))
        soon = Deadline(20.0, "an answer")
        channel.send({"call": "hello", "id": 0, "version": 1}, soon)
        channel.receive(soon)
        call = {"call": "infer", "observation": {"state": {}}}

        def ask_and_never_read() -> None:
            for number in range(10_000):  # 1 MB each comes back
                channel.send({**call, "id": number}, soon)
                time.sleep(0.001)

        with pytest.raises(VlagentsError):
            ask_and_never_read()
        stays.infer(observation)


@pytest.mark.parametrize("kind", ["tcp", "websocket"])
def test_an_expired_certificate_is_named_and_nobody_gets_in(tmp_path: Path, kind: str) -> None:
    key, request, certificate = (tmp_path / name for name in ("key.pem", "request.pem", "cert.pem"))
    openssl(
        ["req", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost", "-keyout", str(key), "-out", str(request)]
        + ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    )
    openssl(
        ["x509", "-req", "-days", "-1", "-in", str(request), "-signkey", str(key), "-out", str(certificate)]
        + ["-copy_extensions", "copy"]
    )
    make: Any = WebsocketServer if kind == "websocket" else Server
    with make(RandomPolicy(size=8), port=0, certificate=certificate, key=key) as server:
        with pytest.raises(ConnectionLost, match="certificate has expired") as caught:
            connect(kind, str(server.address), certificate=certificate, timeout=5.0)
        assert str(server.address) in str(caught.value)
        assert len(server.channels) == 0


def openssl(words: list[str]) -> None:
    """Run the program openssl, which makes certificates; without it, skip the test."""
    try:
        made = subprocess.run(["openssl", *words], capture_output=True, check=False, text=True)
    except FileNotFoundError:
        pytest.skip("needs the program openssl, to make a certificate")
    if made.returncode:
        pytest.skip(f"this openssl does not make such a certificate: {made.stderr[-400:]}")


def test_plain_and_tls_do_not_mix_and_both_say_so(tmp_path: Path, observation: Observation) -> None:
    openssl(
        ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
        + ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
        + ["-keyout", str(tmp_path / "key.pem"), "-out", str(tmp_path / "cert.pem")]
    )
    files = {"certificate": tmp_path / "cert.pem", "key": tmp_path / "key.pem"}
    with Server(RandomPolicy(size=8), port=0, **files) as server:
        port = server.address.port
        with Client(f"vlas://127.0.0.1:{port}", certificate=files["certificate"]) as client:
            client.infer(observation)
        with pytest.raises(ConnectionLost, match=f"TLS, its address is vlas://127.0.0.1:{port}"):
            Client(f"vla://127.0.0.1:{port}")
        with pytest.raises(ConnectionLost, match="certificate"):  # nobody has signed it
            Client(f"vlas://127.0.0.1:{port}", timeout=1.0)
    with Server(RandomPolicy(size=8), port=0) as server, pytest.raises(ConnectionLost, match="TLS"):
        Client(f"vlas://127.0.0.1:{server.address.port}", timeout=1.0)
    hint = pytest.raises(ConnectionLost, match=r"TLS, its address is wss://127\.0\.0\.1")
    with WebsocketServer(RandomPolicy(size=8), port=0, **files) as server, hint:
        WebsocketClient(f"ws://127.0.0.1:{server.address.port}")


@pytest.mark.parametrize(
    "message",
    [
        b"\xc1",
        msgpack.encode([1]),
        msgpack.encode({"x": {b"__ndarray__": True, b"data": b"\0" * 8, b"dtype": "|O", b"shape": [1]}}),
        msgpack.encode({"x": {b"__ndarray__": True, b"data": b"\0" * 8, b"dtype": "<f8", b"shape": [2**62]}}),
        msgpack.encode({"x": {b"__ndarray__": True, b"data": b"\0" * 8, b"dtype": "<f8"}}),
        msgpack.encode({"x": {"y": {"z": {"u": {"v": {"w": 1}}}}}}),
        "text",
    ],
)
def test_a_websocket_client_that_sends_garbage_is_told_and_cut_off(message: Any) -> None:
    with WebsocketServer(RandomPolicy(size=2), port=0) as server, WebsocketClient(str(server.address)) as stays:
        with WebsocketClient(str(server.address)) as evil:
            assert evil._channel is not None
            evil._channel.send(message if isinstance(message, str) else [message], Deadline(5.0, "reading"))
            assert isinstance(evil._channel.receive(Deadline(5.0, "the reason")), str)
            with pytest.raises(ConnectionLost, match="1011"):
                evil._channel.receive(Deadline(5.0, "the end"))
        stays.infer(Observation())
