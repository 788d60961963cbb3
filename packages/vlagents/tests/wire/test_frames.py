from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vlagents.errors import BadMessage, ConnectionLost, DeadlineExceeded
from vlagents.wire.frames import PIECE, FrameChannel, mask_into
from vlagents.wire.link import Deadline, Link
from websockets.frames import Frame, Opcode
from websockets.streams import StreamReader


def soon(seconds: float = 5.0) -> Deadline:
    return Deadline(seconds, "a message")


@pytest.fixture
def channels() -> Iterator[tuple[FrameChannel, FrameChannel]]:
    left, right = socket.socketpair()
    asks, answers = (
        FrameChannel(Link(left), is_client=True),
        FrameChannel(Link(right), is_client=False, largest=1 << 24),
    )
    yield asks, answers
    asks.close()
    answers.close()


@pytest.fixture
def raw() -> Iterator[tuple[socket.socket, FrameChannel]]:
    """A socket of somebody who asks, and the channel that answers."""
    left, right = socket.socketpair()
    answers = FrameChannel(Link(right), is_client=False, largest=1000)
    yield left, answers
    left.close()
    answers.close()


def masked(first: int, data: bytes, size: int | None = None) -> bytes:
    return bytes([first, 0x80 | (len(data) if size is None else size)]) + bytes(4) + data


@given(st.binary(max_size=70), st.binary(min_size=4, max_size=4), st.integers(0, 9))
def test_masking_is_that_of_the_rfc_and_its_own_inverse(data: bytes, key: bytes, at: int) -> None:
    source = np.frombuffer(data, np.uint8)
    out = np.empty_like(source)
    mask_into(out, source, key, at)
    assert out.tolist() == [byte ^ key[(at + i) % 4] for i, byte in enumerate(data)]
    mask_into(out, out, key, at)
    assert out.tobytes() == data


@pytest.mark.parametrize("sizes", [(), (0,), (125,), (126,), (65_535,), (65_536,), (3, PIECE + 5, 7), (1, 5_000_000)])
def test_messages_arrive_both_ways_as_they_were_sent(channels: Any, sizes: tuple[int, ...]) -> None:
    asks, answers = channels
    random = np.random.default_rng(0)
    parts = [random.integers(0, 256, size, np.uint8).tobytes() for size in sizes]
    for sender, reader in ((asks, answers), (answers, asks), (asks, answers)):
        thread = threading.Thread(target=sender.send, args=(parts, soon()))
        thread.start()
        assert bytes(reader.receive(soon())) == b"".join(parts)
        thread.join()


def test_text_arrives_as_text(channels: Any) -> None:
    asks, answers = channels
    asks.send("Würfel", soon())
    assert answers.receive(soon()) == "Würfel"


def test_the_library_reads_what_we_send() -> None:
    left, right = socket.socketpair()
    FrameChannel(Link(left), is_client=True).send([b"a" * 70_000, b"bc"], soon())
    frame = read_frame(right, 70_002 + 14)
    left.close()
    assert frame.data == b"a" * 70_000 + b"bc"
    right.close()


def read_frame(connection: socket.socket, size: int) -> Frame:
    """Read a masked frame with the library."""
    data = b""
    while len(data) < size:
        data += connection.recv(size - len(data))
    reader = StreamReader()
    reader.feed_data(data)
    parsing = Frame.parse(reader.read_exact, mask=True)
    try:
        while True:
            next(parsing)
    except StopIteration as end:
        return end.value


def test_a_message_in_pieces_is_put_together_and_pings_between_them_are_answered(raw: Any) -> None:
    left, answers = raw
    left.sendall(masked(0x02, b"ab") + masked(0x89, b"?") + masked(0x00, b"cd") + masked(0x80, b"e"))
    assert bytes(answers.receive(soon())) == b"abcde"
    assert left.recv(100) == bytes([0x8A, 1]) + b"?"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (masked(0xC2, b"a"), "not in use"),
        (masked(0x83, b"a"), "not in use"),
        (bytes([0x82, 1]) + b"a", "masked"),
        (masked(0x80, b"a"), "goes on where none began"),
        (masked(0x02, b"a") + masked(0x82, b"b"), "inside another"),
        (masked(0x09, b"a"), "control"),
        (bytes([0x89, 0xFE, 0, 200]), "control"),
        (masked(0x81, b"\xff\xfe"), "UTF-8"),
        (bytes([0x82, 0xFF]) + (1001).to_bytes(8, "big") + bytes(4), "too large"),
        (bytes([0x82, 0xFF]) + b"\xff" * 8 + bytes(4), "too large"),
        (masked(0x02, b"a" * 100) + bytes([0x80, 0xFE]) + (901).to_bytes(2, "big") + bytes(4), "too large"),
    ],
)
def test_what_the_rfc_does_not_allow_is_refused(raw: Any, data: bytes, reason: str) -> None:
    left, answers = raw
    left.sendall(data)
    with pytest.raises(BadMessage, match=reason):
        answers.receive(soon())
    assert left.recv(100)[0] == 0x80 | Opcode.CLOSE


@pytest.mark.parametrize(("code", "reason", "told"), [(1000, "done", r"\(1000: done\)"), (1001, "", r"\(1001\)")])
def test_the_end_is_told_and_answered(channels: Any, code: int, reason: str, told: str) -> None:
    asks, answers = channels
    asks.close(code, reason)
    with pytest.raises(ConnectionLost, match=told):
        answers.receive(soon())


def test_silence_is_late_and_a_half_message_too(raw: Any) -> None:
    left, answers = raw
    left.sendall(masked(0x82, b"a", size=50))
    begin = time.monotonic()
    with pytest.raises(DeadlineExceeded):
        answers.receive(Deadline(None, ""), soon(0.2))
    assert time.monotonic() - begin < 3.0


def test_whoever_does_not_read_is_late(channels: Any) -> None:
    asks, _ = channels
    with pytest.raises(DeadlineExceeded):
        asks.send([bytes(20_000_000)], soon(0.2))


def test_pings_are_answered_while_nobody_receives_and_messages_wait(raw: Any) -> None:
    left, answers = raw
    left.sendall(masked(0x89, b"1") + masked(0x8A, b"") + masked(0x89, b"2") + masked(0x82, b"message"))
    answers.attend()
    assert left.recv(100) == bytes([0x8A, 1]) + b"1" + bytes([0x8A, 1]) + b"2"
    assert bytes(answers.receive(soon())) == b"message"


def test_pings_are_not_read_while_another_thread_writes(channels: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asks, _ = channels
    with asks._writing:
        monkeypatch.setattr(asks._link, "peek", lambda: pytest.fail("it was read"))
        asks.attend()
