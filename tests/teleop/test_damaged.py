"""Damaged messages and reports, a hundred thousand of each kind: no decoder fails, and none makes motion of them."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

import numpy as np
import pytest

from rcs.teleop.gello import Answers, packet
from rcs.teleop.headset_messages import FrameMessage, decode, hand_of
from rcs.teleop.input_events import HIGHEST, InputEvents
from rcs.teleop.spacemouse import KnobReports
from rcs.teleop.terminal import TerminalKeys

COUNT = 100_000


def damaged(random_: random.Random, message: bytes) -> bytes:
    """Return a message with a bit turned, cut, made longer, or made of noise."""
    kind = random_.randrange(4)
    if kind == 0 and message:
        at = random_.randrange(len(message))
        return message[:at] + bytes([message[at] ^ 1 << random_.randrange(8)]) + message[at + 1 :]
    if kind == 1:
        return message[: random_.randrange(len(message) + 1)]
    if kind == 2:
        return message + random_.randbytes(random_.randrange(1, 9))
    return random_.randbytes(random_.randrange(20))


def test_reports_of_a_knob() -> None:
    random_ = random.Random(1)
    good = [struct.pack("<B3h", 1, 0, 0, 0), struct.pack("<B6h", 1, *[0] * 6), struct.pack("<B3h", 2, 0, 0, 0), b"\3\0"]
    knob = KnobReports()
    of_use = 0
    for _ in range(COUNT):
        report = damaged(random_, random_.choice(good))
        before = knob.axes.tolist(), knob.keys
        if knob.feed(report):
            of_use += 1  # it cannot be told from a good one, and is bounded
            assert abs(knob.axes).max() <= 1.0
        else:
            assert (knob.axes.tolist(), knob.keys) == before
    assert 0 < of_use < COUNT / 2
    assert knob.damaged > COUNT / 10


@pytest.mark.parametrize("step", [1, 7, 1000])
def test_bytes_of_a_terminal(step: int) -> None:
    random_ = random.Random(step)
    good = [b"\x1b[119u", b"\x1b[119;1:3u", b"\x1b[1;2:2A", b"\x1b[0n", b"\x1b[?62;1c", b"\x1bOA", b"\x1b[O"]
    stream = b"".join(damaged(random_, random_.choice(good)) for _ in range(COUNT // 3))
    while any(code in stream for code in (b"\x03", b"99", b"67")):  # what may be Ctrl-C: as such, c and C
        stream = stream.replace(b"\x03", b"").replace(b"99", b"").replace(b"67", b"")
    keys = TerminalKeys()
    for at in range(0, len(stream), step):
        for event in keys.feed(stream[at : at + step]):
            assert event.kind != "interrupt"
    assert keys.damaged > 0
    keys.feed(b"\x1b" * 100)
    assert [event.key for event in keys.feed(b"\x1b[119;1:3uw")][-2:] == ["w", "w"]


def test_events_of_the_kernel() -> None:
    random_ = random.Random(3)
    good = struct.pack("@llHHi", 0, 0, 1, 17, 1)
    keys = InputEvents("", "")
    feed: Callable[[bytes], None] = keys.feed
    for _ in range(COUNT):
        feed(damaged(random_, good))
        assert all(not key.isdigit() or int(key) <= HIGHEST for key in keys.pressed)
        keys.pressed.clear()
    assert keys.damaged > 0


@pytest.mark.slow
def test_answers_of_servos() -> None:
    random_ = random.Random(4)
    good = packet(1, 0x55, b"\x00" + (2048).to_bytes(4, "little"))
    answers = Answers()
    for _ in range(COUNT):
        sent = damaged(random_, good)
        for servo, values in answers.feed(sent):
            assert good in sent or (servo, values) == (1, b"\x00\x08\x00\x00")
    assert answers.damaged > 0
    assert answers.feed(b"\0" * 64 + good) == [(1, b"\x00\x08\x00\x00")]


def test_messages_of_a_headset() -> None:
    random_ = random.Random(6)
    hand = b'{"pose":[0.1,1,-0.3,0,0,0,1],"trigger":0.25,"buttons":2,"stick":0}'
    good = b'{"number":7,"time":123.4,"round_trip":5,"hands":{"left":%s,"right":%s}}' % (hand, hand)
    of_use = 0
    for _ in range(COUNT):
        message = decode(damaged(random_, good))
        if isinstance(message, FrameMessage):
            of_use += 1
            for name in ("left", "right"):
                reading = hand_of(name, message.hands.get(name))
                assert reading.is_tracked == (reading.pose is not None)
                is_pose = reading.pose is not None and np.isfinite(reading.pose).any()
                assert not is_pose or abs(reading.pose[3:] @ reading.pose[3:] - 1) < 1e-9
                assert reading.opening is None or 0 <= reading.opening <= 1
    assert 0 < of_use < COUNT / 2
