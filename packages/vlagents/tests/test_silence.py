"""A peer that is there no more, without a word: no end of the connection, no reset, packets that lead nowhere."""

from __future__ import annotations

import ctypes
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import pytest
from vlagents import Client, ConnectionLost, DeadlineExceeded, Observation, Server
from vlagents.policies.random import RandomPolicy
from vlagents.websocket import WebsocketClient, WebsocketServer
from vlagents.wire import link

SO_ATTACH_FILTER = 26  # of Linux; Python has no name for it


def pull_cable(connection: socket.socket) -> None:
    """Have the kernel drop whatever comes in for a socket: the other side is never answered, acknowledged or told."""
    drop = ctypes.create_string_buffer(struct.pack("=HBBI", 0x06, 0, 0, 0))  # one instruction: accept 0 bytes
    program = struct.pack("@HP", 1, ctypes.addressof(drop))
    connection.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, program)


class Remembering(RandomPolicy):
    """Keeps which sessions it was told to forget."""

    def __init__(self) -> None:
        super().__init__(size=2)
        self.forgotten: list[str] = []

    def forget(self, session: str) -> None:
        self.forgotten.append(session)
        super().forget(session)


@pytest.fixture(params=[Server, WebsocketServer])
def server(request: pytest.FixtureRequest) -> Iterator[Any]:
    with request.param(Remembering(), port=0) as running:
        yield running


def ask(server: Any, **options: Any) -> Any:
    """Return a client over TCP that has begun an episode."""
    if isinstance(server, WebsocketServer):
        client: Any = WebsocketClient(str(server.address), **options)
    else:
        client = Client(str(server.address), is_shared=False, **options)
    client.reset("left", "pick")
    client.infer(Observation(session="left"))
    return client


def test_a_server_behind_a_pulled_cable_is_late_in_time_and_others_are_answered(server: Any) -> None:
    with ask(server, timeout=10.0) as client:
        (channel,) = server.channels
        pull_cable(channel._link._socket)
        client.timeout = 0.5
        for _ in range(2):
            begin = time.monotonic()
            with pytest.raises((DeadlineExceeded, ConnectionLost)):
                client.infer(Observation(session="left"))
            assert time.monotonic() - begin < 2.0
        with ask(server, timeout=10.0) as other:
            other.infer(Observation(session="left"))


def test_a_client_behind_a_pulled_cable_is_let_go_and_its_sessions_forgotten(
    server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = link.Link.__init__

    def impatient(self: Any, connection: socket.socket) -> None:
        """Ask after a silent peer after one second, not thirty."""
        before(self, connection)
        if connection.family != socket.AF_UNIX:
            for name in ("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), 1)

    monkeypatch.setattr(link.Link, "__init__", impatient)
    client = ask(server, timeout=10.0)
    assert len(server.channels) == 1
    pull_cable(client._channel._link._socket)
    deadline = time.monotonic() + 20.0
    while (server.channels or not server.service._policy.forgotten) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(server.channels) == 0
    assert len(server.service._policy.forgotten) == 1
    client.close()
