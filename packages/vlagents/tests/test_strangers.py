"""Whoever is not let in: pages in a browser, those who have no token, those who say nothing."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import msgpack
from vlagents import Chunk, Metadata, Observation, PartSpec, Policy, Server, connect
from vlagents.other_wires.groot import GrootServer
from vlagents.other_wires.openvla import OpenvlaServer
from vlagents.websocket import WebsocketServer

SERVERS: dict[str, Any] = {"vla": Server, "ws": WebsocketServer, "gr00t": GrootServer, "openvla": OpenvlaServer}
METADATA = Metadata(name="counting", action=(PartSpec("joints", 2),), rate=10.0)
ORIGINS = ["http://example.org", "null", "http://127.0.0.1", "chrome-extension://abc"]
UPGRADE = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    "Sec-WebSocket-Version: 13\r\n"
)


@pytest.mark.parametrize(("kind", "port"), [("vla", 8090), ("ws", 8000), ("gr00t", 5555), ("openvla", 8000)])
def test_a_server_has_the_port_of_its_wire_or_the_one_that_is_given(kind: str, port: int) -> None:
    assert SERVERS[kind](Counting()).address.port == port
    assert SERVERS[kind](Counting(), port=4000).address.port == 4000


class Counting(Policy):
    """Counts how often it was asked, however that came about."""

    def __init__(self) -> None:
        self.asked = 0

    def metadata(self) -> Metadata:
        return METADATA

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.asked += 1

    def infer(self, observation: Observation) -> Chunk:
        self.asked += 1
        return Chunk(np.zeros((1, 2)), 0.1)


def client(server: Any, **options: Any) -> Any:
    """Return a client of the server's own kind, over TCP."""
    if isinstance(server, Server):
        options["is_shared"] = False
    elif isinstance(server, (GrootServer, OpenvlaServer)):
        options["metadata"] = METADATA
    return connect(str(server.address), timeout=options.pop("timeout", 10.0), **options)


def observation() -> Observation:
    return Observation({"image": np.zeros((4, 4, 3), np.uint8)}, instruction="pick")


def told(server: Any, data: bytes) -> bytes:
    """Send bytes, and return what comes until the connection ends."""
    came = b""
    with socket.create_connection((server.address.host, server.address.port), timeout=10.0) as peer:
        try:
            peer.sendall(data)
            while part := peer.recv(1 << 16):
                came += part
        except ConnectionError:
            pass  # it ended before all was sent
    return came


@pytest.mark.parametrize("origin", ORIGINS)
def test_a_page_in_a_browser_gets_no_websocket(origin: str, caplog: pytest.LogCaptureFixture) -> None:
    policy = Counting()
    with WebsocketServer(policy, port=0) as server:
        request = f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: {origin}\r\n{UPGRADE}\r\n"
        assert told(server, request.encode()).startswith(b"HTTP/1.1 403 ")
        client(server).infer(observation())
    assert policy.asked == 1
    assert "Pages in browsers are refused" in caplog.text


@pytest.mark.parametrize("origin", ORIGINS)
def test_a_page_in_a_browser_cannot_post(origin: str) -> None:
    policy = Counting()
    body = '{"image": {"__numpy__": "AAAA", "dtype": "|u1", "shape": [1, 1, 3]}, "instruction": "pick"}'
    with OpenvlaServer(policy, port=0) as server:
        head = f"POST /act HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\nContent-Length: {len(body)}\r\n"
        assert told(server, f"{head}Origin: {origin}\r\n\r\n{body}".encode()).startswith(b"HTTP/1.0 403 ")
        assert policy.asked == 0
        assert told(server, f"{head}\r\n{body}".encode()).startswith(b"HTTP/1.0 200 ")
    assert policy.asked == 1


def as_old_zeromq(asked: bytes) -> bytes:
    """Return a request of HTTP, as a page sends one with `fetch`, which is also one of ZeroMQ's version 2.

    There, a frame is its length, flags and content, and the first byte of `POST` is a length like any other. The path
    is as long as it takes for a frame to end where the page's own bytes begin.
    """
    body = b"\x01\x01" + b"\xff" + struct.pack(">Q", len(asked) + 1) + b"\x00" + asked
    for padding in range(1, 4000):
        head = b"POST /" + b"z" * padding + b" HTTP/1.1\r\nHost: 127.0.0.1:5555\r\nOrigin: http://example.org\r\n"
        head += b"Content-Type: text/plain\r\nContent-Length: %d\r\n\r\n" % len(body)
        at, has_more = 0, True
        while at < len(head):
            has_more = bool(head[at + 1 : at + 2] and head[at + 1] & 1)
            at += 1 + head[at]
        if at == len(head) and not has_more:
            return head + body
    raise AssertionError("no path is of the right length")


def test_what_a_page_fetches_from_gr00ts_port_is_no_request() -> None:
    policy = Counting()
    with GrootServer(policy, port=0) as server:
        with socket.create_connection((server.address.host, server.address.port), timeout=10.0) as page:
            page.sendall(as_old_zeromq(msgpack.encode({"endpoint": "reset", "data": {}})))
            page.settimeout(1.0)
            try:
                while page.recv(1 << 16):
                    pass
            except OSError:
                pass
        client(server).infer(observation())
    assert policy.asked == 1


@pytest.mark.parametrize("kind", SERVERS)
def test_those_who_say_nothing_shut_nobody_out(kind: str) -> None:
    with SERVERS[kind](Counting(), port=0, token="secret") as server, ExitStack() as opened:
        place = (server.address.host, server.address.port)
        stays = opened.enter_context(client(server, token="secret"))
        stays.infer(observation())
        for _ in range(70):
            opened.enter_context(socket.create_connection(place, timeout=10.0))
        comes = opened.enter_context(client(server, token="secret", timeout=2.0))
        comes.infer(observation())
        stays.infer(observation())


SERVE = """
import logging, sys, threading
sys.path.insert(0, sys.argv[2])
import test_strangers
logging.disable(logging.CRITICAL)
token = None if sys.argv[3] == "none" else sys.argv[3]
server = test_strangers.SERVERS[sys.argv[1]](test_strangers.Counting(), port=0, token=token).start()
print(server.address, flush=True)
threading.Event().wait()
"""


def peak_mb(process: int) -> float:
    """Return the most memory that a process ever had [MB]."""
    line = next(x for x in Path(f"/proc/{process}/status").read_text().splitlines() if x.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


READY = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03REQ"
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32) + bytes([4, len(READY)]) + READY


def zeromq(*frames: bytes) -> bytes:
    """Return a message of ZeroMQ's."""
    flags = [3] * (len(frames) - 1) + [2]
    return b"".join(struct.pack(">BQ", flag, len(each)) + each for flag, each in zip(flags, frames, strict=True))


def websocket(content: bytes, kind: int = 2) -> bytes:
    """Return what a client of a websocket says who sends one message, with a mask that changes nothing."""
    head = struct.pack(">BBQ4x", 0x80 | kind, 0xFF, len(content))
    return f"GET / HTTP/1.1\r\nHost: x\r\n{UPGRADE}\r\n".encode() + head + content


def post(content: bytes) -> bytes:
    return b"POST /act HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(content) + content


def maps(count: int) -> bytes:
    """Return a list of so many empty dictionaries, as msgpack."""
    return b"\xdd" + count.to_bytes(4, "big") + b"\x80" * count


EVIL: dict[str, Any] = {
    "many empty dictionaries": ("ws", "none", lambda: websocket(maps(64 << 20))),
    "text": ("ws", "none", lambda: websocket("\U0001f916".encode() + b"a" * (30 << 20), kind=1)),
    "no token": ("gr00t", "secret", lambda: zeromq(b"", maps(16 << 20))),
    "many parts": ("gr00t", "none", lambda: zeromq(b"", *[bytes(1 << 20)] * 200)),
    "many empty lists": ("openvla", "none", lambda: post(b"[" + b"[]," * 10_000_000 + b"[]]")),
}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc, to see how much memory a process has")
@pytest.mark.parametrize("what", EVIL)
def test_a_message_takes_little_more_memory_than_it_has(what: str) -> None:
    kind, token, make = EVIL[what]
    serving = subprocess.Popen(
        [sys.executable, "-c", SERVE, kind, str(Path(__file__).parent), token], stdout=subprocess.PIPE, text=True
    )
    try:
        assert serving.stdout is not None
        host, port = serving.stdout.readline().strip().split("//")[1].split(":")
        before = peak_mb(serving.pid)
        with socket.create_connection((host, int(port)), timeout=60.0) as evil:
            if kind == "gr00t":
                evil.sendall(GREETING)
                came = b""
                while b"ROUTER" not in came:  # ZeroMQ's library takes no message before it has greeted, too
                    came += evil.recv(1 << 16)
            try:
                evil.sendall(make())
                evil.settimeout(5.0)
                while evil.recv(1 << 16):
                    pass
            except OSError:
                pass  # it was cut off
        assert peak_mb(serving.pid) - before < 100.0
    finally:
        serving.kill()
        serving.wait()
