"""Unix sockets beside ports: whoever is killed leaves one, which the next server removes, and no other."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from vlagents import Client, Observation, Server
from vlagents.policies.random import RandomPolicy
from vlagents.wire.local_socket import socket_folder
from vlagents.wire.shared import is_supported

pytestmark = pytest.mark.skipif(not is_supported(), reason="needs shared memory without a name")

SERVE = """
from vlagents.policies.random import RandomPolicy
from vlagents import Server
with Server(RandomPolicy(), port=0) as server:
    print(server.address, flush=True)
    server.serve_forever()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return socket_folder()


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def serve() -> tuple[subprocess.Popen[str], str]:
    served = subprocess.Popen([sys.executable, "-c", SERVE], stdout=subprocess.PIPE, text=True)
    assert served.stdout is not None
    return served, served.stdout.readline().strip()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_socket_of_a_killed_server_is_removed_by_the_next(folder: Path, number: signal.Signals) -> None:
    served, _ = serve()
    served.send_signal(number)
    served.wait()
    assert len(names(folder)) == 1
    with Server(RandomPolicy(), port=0) as server:
        assert names(folder) == {f"{server.address.port}.sock"}
    assert not names(folder)


def test_what_lives_and_what_is_no_socket_of_a_server_stays(folder: Path) -> None:
    (folder / "8090.sock").write_text("a file")
    (folder / "8091.sock").symlink_to(folder / "elsewhere")
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(folder / "other.sock"))
    full = socket.socket(socket.AF_UNIX)
    full.bind(str(folder / "8092.sock"))
    full.listen(0)  # never accepts: it lives, though it has no place for another connection
    waiting = [socket.socket(socket.AF_UNIX) for _ in range(2)]
    for connection in waiting:
        connection.setblocking(False)
        connection.connect_ex(str(folder / "8092.sock"))
    early = socket.socket(socket.AF_UNIX)
    early.bind(str(folder / "8093.sock"))  # it does not listen yet
    before = names(folder)
    with Server(RandomPolicy(), port=0) as first, Client(str(first.address)) as client:
        with Server(RandomPolicy(), port=0):
            assert client.is_shared
            client.infer(Observation())
            assert first.clients == 1
        with Client(str(first.address)) as another:
            assert another.is_shared
    assert names(folder) == before
    for connection in (early, full, *waiting):
        connection.close()


def test_servers_that_start_together_leave_each_other_alone(folder: Path) -> None:
    started = [serve() for _ in range(2)]
    for served, _ in started:
        served.kill()
        served.wait()
    servers = [Server(RandomPolicy(), port=0) for _ in range(16)]
    gate = threading.Barrier(len(servers))

    def start(server: Server) -> None:
        gate.wait(20.0)
        server.start()

    threads = [threading.Thread(target=start, args=(server,)) for server in servers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    try:
        assert names(folder) == {f"{server.address.port}.sock" for server in servers}
        for server in servers:
            with Client(str(server.address), is_shared=True) as client:
                client.infer(Observation())
    finally:
        for server in servers:
            server.close()


def test_a_server_that_is_looking_through_the_folder_is_waited_for(folder: Path) -> None:
    lock = os.open(folder, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(folder / "8090.sock"))
    server = Server(RandomPolicy(), port=0)
    starting = threading.Thread(target=server.start)
    starting.start()
    starting.join(0.3)
    assert names(folder) == {"8090.sock"}
    os.close(lock)
    starting.join(20.0)
    assert names(folder) == {f"{server.address.port}.sock"}
    server.close()


def test_where_the_folder_cannot_be_locked_nothing_is_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(file: int, what: int) -> None:
        raise OSError(9, "no locks here, as on a network's file system")

    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(folder / "8090.sock"))  # perhaps another machine listens there
    monkeypatch.setattr(fcntl, "flock", refuse)
    with Server(RandomPolicy(), port=0) as server, Client(str(server.address), is_shared=True):
        assert names(folder) == {"8090.sock", f"{server.address.port}.sock"}
