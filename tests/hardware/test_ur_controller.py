"""Checks of a UR controller before the vendor's library is given its address."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from rcs.errors import DeviceFault
from rcs.hardware.ur_controller import Dashboard, require_controller, stop_program

ADDRESS = f"127.{192 + (os.getpid() >> 8) % 63}.{os.getpid() % 250 + 1}.1"
BANNER = b"Connected: Universal Robots Dashboard Server\n"
Answer = Callable[[bytes], bytes]


class Peer:
    """Answers on one port, or says nothing."""

    def __init__(self, port: int, answer: Answer | None = None, banner: bytes = b"") -> None:
        self.listener = socket.create_server((ADDRESS, port))
        self.answer, self.banner = answer, banner
        self.clients: list[socket.socket] = []
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self) -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                client = self.listener.accept()[0]
                self.clients.append(client)
                client.sendall(self.banner)
                while self.answer is not None and (data := client.recv(4096)):
                    client.sendall(self.answer(data))

    def close(self) -> None:
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for client in self.clients:
            client.close()
        self.thread.join(2.0)


@pytest.fixture
def peers() -> Iterator[list[Peer]]:
    made: list[Peer] = []
    yield made
    for peer in made:
        peer.close()


def dashboard(data: bytes) -> bytes:
    return b"URSoftware 5.4.1\n"


def rtde_of(version: int) -> Answer:
    def answer(data: bytes) -> bytes:
        is_it = struct.unpack(">HBH", data)[2] == version
        return struct.pack(">HB?", 4, ord("V"), is_it)

    return answer


def refusal() -> str:
    """Return why the controller is refused, and check that this took less than three seconds."""
    begin = time.monotonic()
    with pytest.raises(DeviceFault) as caught:
        require_controller(ADDRESS)
    assert time.monotonic() - begin < 3.0
    return str(caught.value)


def test_an_address_without_a_controller_is_refused() -> None:
    text = refusal()
    assert ADDRESS in text
    assert "29999 (dashboard)" in text
    assert "Settings" in text


def test_a_mute_peer_is_refused_while_other_threads_run(peers: list[Peer]) -> None:
    peers.append(Peer(29999))
    counted = 0
    is_over = threading.Event()

    def count() -> None:
        nonlocal counted
        while not is_over.wait(0.01):
            counted += 1

    thread = threading.Thread(target=count)
    thread.start()
    text = refusal()
    is_over.set()
    thread.join()
    assert "sends nothing" in text
    assert counted > 20


def test_a_controller_with_a_mute_rtde_is_refused(peers: list[Peer]) -> None:
    peers += [Peer(29999, dashboard, BANNER), Peer(30004)]
    assert "30004 (RTDE)" in refusal()


def test_something_else_that_listens_is_refused(peers: list[Peer]) -> None:
    peers.append(Peer(29999, dashboard, b"SSH-2.0-OpenSSH\n"))
    assert "not a UR controller" in refusal()


@pytest.mark.parametrize(("spoken", "mend"), [(1, "PolyScope"), (3, "pip install -U ur-rtde"), (9, "another version")])
def test_another_version_is_refused_with_both_and_what_to_install(spoken: int, mend: str, peers: list[Peer]) -> None:
    peers += [Peer(29999, dashboard, BANNER), Peer(30004, rtde_of(spoken))]
    text = refusal()
    assert "ur-rtde speaks version 2" in text
    assert "URSoftware 5.4.1" in text
    assert mend in text
    assert spoken == 9 or f"version {spoken} of RTDE" in text


def test_a_controller_that_answers_everywhere_is_accepted(peers: list[Peer]) -> None:
    peers += [Peer(29999, dashboard, BANNER), Peer(30004, rtde_of(2)), Peer(30002)]
    require_controller(ADDRESS)


def test_a_dashboard_that_hangs_up_is_a_fault(peers: list[Peer]) -> None:
    peers.append(Peer(29999, None, BANNER))
    with Dashboard(ADDRESS) as client:
        peers[0].clients[0].close()
        with pytest.raises(DeviceFault, match=r"closed the connection|is lost"):
            client.ask("robotmode")


@pytest.mark.parametrize("is_running", [True, False])
def test_a_stop_that_fails_is_a_fault_where_a_program_runs(peers: list[Peer], is_running: bool) -> None:
    """Without one, as after a protective stop, there is nothing to stop."""

    def answer(data: bytes) -> bytes:
        return b"Failed to execute: stop\n" if data == b"stop\n" else f"Program running: {is_running}\n".encode()

    peers.append(Peer(29999, answer, BANNER))
    with contextlib.ExitStack() as stack:
        if is_running:
            stack.enter_context(pytest.raises(DeviceFault, match="cannot be stopped: Failed to execute"))
        stop_program(ADDRESS)
