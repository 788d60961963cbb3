from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from vlagents import BadMessage, Client, ConnectionLost, Observation, Server
from vlagents.policies.random import RandomPolicy
from vlagents.wire.link import Deadline
from vlagents.wire.shared import HEAD, MAGIC, PLACE, SharedChannel, UnixLink, is_supported, name_beside
from vlagents.wire.stream import PREFIX

pytestmark = pytest.mark.skipif(not is_supported(), reason="needs memory without a name, which this system has not")


def soon() -> Deadline:
    return Deadline(5.0, "a message")


def named_memory() -> set[str]:
    """Return the names of shared memory on this machine; semaphores and arrays of other programs come and go."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith(("sem.", "pym-"))}


@pytest.fixture
def channels() -> Iterator[tuple[SharedChannel, SharedChannel]]:
    a, b = socket.socketpair(socket.AF_UNIX)
    left, right = SharedChannel(UnixLink(a)), SharedChannel(UnixLink(b))
    yield left, right
    left.close()
    right.close()


def test_messages_of_all_sizes_come_as_they_were_sent(channels: Any) -> None:
    left, right = channels
    random = np.random.default_rng(0)
    for size in (0, 10, 70_000, 70_001, 5_000_000, 10, 900_000, 20_000_000, 100_000):
        image = random.integers(0, 255, size, np.uint8)
        left.send({"image": image, "n": size}, soon())
        came = right.receive(soon())
        assert came["n"] == size
        np.testing.assert_array_equal(came["image"], image)


def test_what_came_is_the_readers_to_keep_and_to_write(channels: Any) -> None:
    left, right = channels
    kept = []
    for fill in range(6):
        left.send({"image": np.full(1_000_000, fill, np.uint8), "state": np.full(7, float(fill))}, soon())
        kept.append(right.receive(soon()))
        kept[-1]["image"][:10] += 100
    for fill, came in enumerate(kept):
        assert came["state"].tolist() == [fill] * 7
        assert set(came["image"][:10]) == {fill + 100}
        assert set(came["image"][10:]) == {fill}


def test_memory_that_nobody_keeps_is_used_again(channels: Any) -> None:
    left, right = channels
    places = set()
    for fill in range(6):
        left.send({"a": np.full(1_000_000, fill, np.uint8)}, soon())
        places.add(right.receive(soon())["a"].ctypes.data)
    assert len(places) == 1


def test_the_third_of_messages_that_nobody_read_takes_the_place_of_the_first(channels: Any) -> None:
    left, right = channels
    for fill in (1, 2):
        left.send({"a": np.full(100_000, fill, np.uint8)}, soon())
    assert [right.receive(soon())["a"][0] for _ in range(2)] == [1, 2]
    for fill in (3, 4, 5):
        left.send({"a": np.full(100_000, fill, np.uint8)}, soon())
    with pytest.raises(BadMessage, match="does not hold"):
        right.receive(soon())


def test_nothing_is_left_behind(channels: Any) -> None:
    before = named_memory()
    left, right = channels
    left.send({"a": np.zeros(100_000, np.uint8)}, soon())
    right.receive(soon())
    assert named_memory() == before


def test_no_file_stays_open(channels: Any) -> None:
    left, right = channels
    before = len(os.listdir("/proc/self/fd"))
    for size in (100_000, 3_000_000, 30_000_000):
        left.send({"a": np.zeros(size, np.uint8)}, soon())
        right.receive(soon())
    left.close()
    right.close()
    assert len(os.listdir("/proc/self/fd")) <= before


def send_raw(left: SharedChannel, file: int | None, *, number: int, slot: int, slot_size: int, size: int) -> None:
    frame = PREFIX.pack(MAGIC, 1, size) + PLACE.pack(number, slot, slot_size) + b"\xc0"
    if file is None:
        left._unix.send([memoryview(frame)], soon())
    else:
        left._unix.send_file(memoryview(frame), file, soon())


@pytest.mark.parametrize(
    ("slot", "slot_size", "size", "number", "words"),
    [
        (2, 1 << 20, 100, 1, "no room"),
        (2**63, 1 << 20, 100, 1, "no room"),
        (0, 1 << 20, 1 << 20, 1, "no room"),
        (0, 2**63, 100, 1, "no room"),
        (0, 1 << 20, 100, 5, "does not hold message 5"),
    ],
)
def test_a_place_that_is_none_is_refused(
    channels: Any, slot: int, slot_size: int, size: int, number: int, words: str
) -> None:
    left, right = channels
    left.send({"a": np.zeros(100_000, np.uint8)}, soon())
    right.receive(soon())
    send_raw(left, None, number=number, slot=slot, slot_size=slot_size, size=size)
    with pytest.raises(BadMessage, match=words):
        right.receive(soon())


def test_memory_that_could_shrink_is_refused(channels: Any) -> None:
    left, right = channels
    file = os.memfd_create("evil", os.MFD_ALLOW_SEALING)
    os.ftruncate(file, 2 << 20)
    send_raw(left, file, number=0, slot=0, slot_size=1 << 20, size=100)
    os.close(file)
    with pytest.raises(BadMessage, match="sealed"):
        right.receive(soon())


def test_a_file_on_disk_is_refused(channels: Any, tmp_path: Any) -> None:
    left, right = channels
    (tmp_path / "file").write_bytes(bytes(2 << 20))
    file = os.open(tmp_path / "file", os.O_RDWR)
    send_raw(left, file, number=0, slot=0, slot_size=1 << 20, size=100)
    os.close(file)
    with pytest.raises(BadMessage, match="sealed"):
        right.receive(soon())


def test_a_message_without_memory_is_refused(channels: Any) -> None:
    left, right = channels
    send_raw(left, None, number=0, slot=0, slot_size=1 << 20, size=100)
    with pytest.raises(BadMessage, match="no room"):
        right.receive(soon())


def test_a_slot_has_room_for_its_number_before_the_arrays() -> None:
    assert HEAD >= 8


def test_channels_serve_threads_on_both_sides(channels: Any) -> None:
    left, right = channels
    answered = []

    def serve() -> None:
        for _ in range(50):
            came = right.receive(soon())
            right.send({"sum": int(came["a"].sum())}, soon())

    thread = threading.Thread(target=serve)
    thread.start()
    for i in range(50):
        left.send({"a": np.full(100_000, i, np.uint8)}, soon())
        answered.append(left.receive(soon())["sum"])
    thread.join()
    assert answered == [100_000 * i for i in range(50)]


def test_a_channel_that_another_thread_stops_is_closed_by_the_one_that_uses_it(channels: Any) -> None:
    left, right = channels
    left.send({"a": np.zeros(100_000, np.uint8)}, soon())
    came = right.receive(soon())
    files = len(os.listdir("/proc/self/fd"))
    threading.Timer(0.05, right.stop).start()
    with pytest.raises(ConnectionLost):
        right.receive(soon())
    assert came["a"].sum() == 0  # its memory stayed
    with pytest.raises(ConnectionLost):
        left.receive(soon())
    assert len(os.listdir("/proc/self/fd")) < files


SERVE = """
import sys
from vlagents import Server
from vlagents.policies.random import RandomPolicy
with Server(RandomPolicy(), port=int(sys.argv[1])) as server:
    print(server.address, flush=True)
    server.serve_forever()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_server_leaves_nothing_in_the_way_of_the_next(number: signal.Signals) -> None:
    port = "0"
    for _ in range(2):
        with subprocess.Popen([sys.executable, "-c", SERVE, port], stdout=subprocess.PIPE, text=True) as served:
            assert served.stdout is not None
            address = served.stdout.readline().strip()
            with Client(address, is_shared=True) as client:
                client.infer(Observation())
            served.send_signal(number)
        port = address.rpartition(":")[2]


def test_a_socket_whose_name_is_taken_leaves_tcp(caplog: pytest.LogCaptureFixture) -> None:
    with Server(RandomPolicy(), port=0) as server, socket.socket(socket.AF_UNIX) as taken:
        address = server.address
        server.close()
        taken.bind(name_beside(address))
        with Server(RandomPolicy(), port=address.port), Client(str(address)) as client:
            assert not client.is_shared
            client.infer(Observation())
            with pytest.raises(ConnectionLost, match="no server on this machine"):
                Client(str(address), is_shared=True)
        assert "no shared memory" in caplog.text


def test_localhost_is_the_same_machine() -> None:
    with Server(RandomPolicy(), port=0) as server, Client(f"vla://localhost:{server.address.port}") as client:
        assert client.is_shared
