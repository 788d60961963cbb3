"""A websocket's handshake, as either side reads the other's bytes."""

from __future__ import annotations

import socket

import pytest
from vlagents import BadMessage, ConnectionLost, Unauthorized
from vlagents.wire.handshake import LONGEST, REFUSAL, accept, ask
from vlagents.wire.link import Deadline, Link

REQUEST = (
    b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)


def soon() -> Deadline:
    return Deadline(5.0, "a handshake")


def test_bytes_behind_the_request_belong_to_the_websocket() -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(REQUEST + b"\r\nbehind")
        link = Link(other)
        assert accept(link, soon(), lambda request: None)
        assert bare.recv(1000).startswith(b"HTTP/1.1 101 ")
        assert link.take(6, soon()) == b"behind"
        link.close()


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"POST / HTTP/1.1\r\n\r\n", REFUSAL[:12]),
        (REQUEST + b"Origin: null\r\n\r\n", b"HTTP/1.1 403"),
        (b"GET x\r\n\r\n", b""),
    ],
)
def test_what_is_no_request_of_a_program_is_refused(sent: bytes, status: bytes) -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(sent)
        link = Link(other)
        with pytest.raises(BadMessage):
            accept(link, soon(), lambda request: None)
        link.close()
        assert bare.recv(1000)[:12] == status


def test_another_answer_than_a_websocket_is_sent_as_it_is() -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(REQUEST + b"\r\n")
        link = Link(other)
        assert not accept(link, soon(), lambda request: (200, "OK\n"))
        assert bare.recv(1000).endswith(b"OK\n")
        link.close()


@pytest.mark.parametrize("more", [0, 1])
def test_a_head_has_a_longest_length(more: int) -> None:
    bare, other = socket.socketpair()
    with bare:
        begin = REQUEST + b"X: " + b"a" * 6000 + b"\r\nY: " + b"a" * 6000 + b"\r\nZ: "
        bare.sendall(begin + b"a" * (LONGEST - len(begin) - 4 + more) + b"\r\n\r\n")
        link = Link(other)
        if more:
            with pytest.raises(BadMessage, match=f"more than {LONGEST} bytes"):
                accept(link, soon(), lambda request: None)
        else:
            assert accept(link, soon(), lambda request: None)
        link.close()


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", Unauthorized),
        (b"HTTP/1.1 200 OK\r\n\r\n", ConnectionLost),
        (b"HTTP/1.1 101 Switching Protocols\r\n\r\n", ConnectionLost),
        (b"nonsense\r\n\r\n", ConnectionLost),
    ],
)
def test_a_server_without_a_websocket_is_a_typed_error(answer: bytes, error: type[Exception]) -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(answer)
        link = Link(other)
        with pytest.raises(error):
            ask(link, "ws://127.0.0.1:1", {"Authorization": "Api-Key secret"}, soon())
        assert b"\r\nAuthorization: Api-Key secret\r\n" in bare.recv(10_000)
        link.close()


def test_a_page_is_refused_whatever_it_asks_for() -> None:
    bare, other = socket.socketpair()
    with bare:
        bare.sendall(REQUEST + b"Origin: http://x\r\n\r\n")
        link = Link(other)
        with pytest.raises(BadMessage, match="http://x"):
            accept(link, soon(), lambda request: (200, "OK\n"))
        link.close()
        assert bare.recv(1000)[:12] == b"HTTP/1.1 403"
