"""ZeroMQ's requests and replies, byte by byte."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator

import pytest
from vlagents import BadMessage, ConnectionLost, DeadlineExceeded
from vlagents.wire.link import Deadline, Link
from vlagents.wire.zmtp import GREETING, ZmtpChannel

READY = {
    kind: b"\x05READY\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind for kind in (b"REQ", b"PUB", b"ROUTER")
}


def soon(seconds: float = 5.0) -> Deadline:
    return Deadline(seconds, "a message")


def command(content: bytes) -> bytes:
    return bytes([4, len(content)]) + content


@pytest.fixture
def peer() -> Iterator[tuple[socket.socket, ZmtpChannel]]:
    """Give a client's bare end, and a server's channel that has greeted it."""
    bare, other = socket.socketpair()
    bare.settimeout(5.0)
    channel = ZmtpChannel(Link(other), is_client=False, largest=1000)
    bare.sendall(GREETING + command(READY[b"REQ"]))
    channel.greet(soon())
    assert received(bare, len(GREETING)) == GREETING
    assert received(bare, 2 + len(READY[b"ROUTER"])) == command(READY[b"ROUTER"])
    yield bare, channel
    bare.close()
    channel.close()


def received(bare: socket.socket, count: int) -> bytes:
    found = b""
    while len(found) < count:
        found += bare.recv(count - len(found))
    return found


def test_both_sides_greet_and_exchange_requests_and_replies() -> None:
    ends = socket.socketpair()
    client, server = (
        ZmtpChannel(Link(end), is_client=is_client) for end, is_client in zip(ends, (True, False), strict=True)
    )
    greeting = threading.Thread(target=client.greet, args=(soon(),))
    greeting.start()
    server.greet(soon())
    greeting.join()
    for content in (b"", b"x", b"y" * 100_000):
        client.send(content, soon())
        assert bytes(server.receive(soon())) == content
        server.send(content[::-1], soon())
        assert bytes(client.receive(soon(), soon())) == content[::-1]
    client.close()
    with pytest.raises(ConnectionLost):
        server.receive(soon())


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"GET / HTTP/1.1\r\n", "not how ZeroMQ begins"),
        (b"\xff" + bytes(9), "not how ZeroMQ begins"),
        (GREETING.replace(b"\x7f\x03", b"\x7f\x02"), "version 2"),
        (GREETING.replace(b"NULL", b"PLAIN"[:4]), "PLAI"),
        (GREETING + command(READY[b"PUB"]), "type b'PUB'"),
        (GREETING + b"\x00" + bytes([len(READY[b"REQ"])]) + READY[b"REQ"], "type None"),
    ],
)
def test_whoever_does_not_greet_as_a_client_is_refused(sent: bytes, words: str) -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(sent)
        bare.shutdown(socket.SHUT_WR)
        with pytest.raises(BadMessage, match=words):
            ZmtpChannel(Link(other), is_client=False).greet(soon())


def test_a_ping_between_frames_is_answered_and_other_commands_are_passed_over(
    peer: tuple[socket.socket, ZmtpChannel],
) -> None:
    bare, channel = peer
    bare.sendall(b"\x01\x00" + command(b"\x04PING\x00\x0acontext") + command(b"\x05OTHER") + b"\x00\x03abc")
    assert bytes(channel.receive(soon())) == b"abc"
    assert received(bare, 14) == command(b"\x04PONGcontext")


@pytest.mark.parametrize(
    "frames",
    [
        b"\x00\x03abc",  # no empty frame
        b"\x01\x01a\x00\x03abc",  # the first frame is not empty
        b"\x01\x00\x01\x03abc\x00\x00",  # more than one frame
        b"\x01\x00\x02" + struct.pack(">Q", 1001),  # too long
        b"\x01\x00\x06" + struct.pack(">Q", 256),  # a long command
        b"\x09\x00\x00\x03abc",  # flags that are not in use
    ],
)
def test_frames_against_the_rule_end_the_connection(peer: tuple[socket.socket, ZmtpChannel], frames: bytes) -> None:
    bare, channel = peer
    bare.sendall(frames)
    with pytest.raises(BadMessage):
        channel.receive(soon())
    assert bare.recv(1) == b""


def test_a_message_of_the_largest_size_is_read(peer: tuple[socket.socket, ZmtpChannel]) -> None:
    bare, channel = peer
    bare.sendall(b"\x01\x00\x02" + struct.pack(">Q", 1000) + bytes(1000))
    assert len(channel.receive(soon())) == 1000
    bare.sendall(b"\x01")
    with pytest.raises(DeadlineExceeded):
        channel.receive(soon(), soon(0.1))
