"""A hundred thousand damaged messages on the way of an input: a robot that follows a still hand stays still."""

from __future__ import annotations

import json
import os
import random
import socket
import ssl
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3
from rcs.robots.so101 import SO101
from rcs.rollout.interactive.page_link import PageKeys, PageLink
from rcs.spatial import distance
from rcs.teleop import Keyboard, Operator, Quest, Reading, SpaceMouse, Vive, credentials, gello, vive_relay
from rcs.teleop.device_file import DeviceFile
from rcs.teleop.headset_messages import decode
from rcs.teleop.input_events import EVENT, HIGHEST, InputEvents
from rcs.teleop.keyboard import MOTIONS
from rcs.teleop.so101_leader import so101_leader, uncalibrated
from rcs.teleop.spacemouse import KnobReports
from rcs.teleop.terminal import Terminal, TerminalKeys
from tests.teleop.leaders import COUNTS, STEP, bus_of, calibrated, saved
from tests.teleop.test_damaged import COUNT, damaged

pytestmark = pytest.mark.slow

TOGETHER = 50
"""Damaged messages between two good ones."""


@pytest.fixture(autouse=True)
def quick_threads() -> Iterator[None]:
    """Have three threads that wait for each other 10⁵ times take seconds, not minutes."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(before)


def lead(device: Any, send: Callable[[bool], bool], counted: Callable[[], int], *, robot: str = "fr3") -> None:
    """Have a robot follow a hand that is still, then moves.

    Args:
        device: The device that the hand holds.
        send: Sends a good message, and `TOGETHER` damaged ones after it, or, given True, good ones of a hand that
            moves; returns False when `COUNT` damaged ones were sent.
        counted: Returns how many damaged messages the device has counted.
        robot: The robot.
    """
    with rcs.make("Free", robot=robot, stepping="async", max_episode_steps=None, binary_gripper=False) as env:
        operator = Operator(env, device)
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)
        start, states, is_sending, has_ended = np.array(observation["tquat"]), set[str](), [True], threading.Event()

        def run() -> None:
            while send(False):
                end = time.monotonic() + 20
                while counted() < device.sent_damaged and time.monotonic() < end:
                    time.sleep(0.0005)
            is_sending.clear()
            while not has_ended.is_set():
                send(True)
                time.sleep(0.005)

        sender = threading.Thread(target=run, daemon=True)
        sender.start()
        while is_sending:
            observation, _, _, _, info = env.step(operator.act(observation, info))
            states.add(operator.states["right"])
            way, turn = distance(start, observation["tquat"])
            assert way < 1e-4
            assert turn < 1e-3
        assert counted() >= 0.99 * COUNT  # a busy machine loses packets
        end = time.monotonic() + 60
        while np.linalg.norm(observation["tquat"][:3] - start[:3]) < 0.02:  # and it still follows
            assert time.monotonic() < end, operator.problem
            observation, _, _, _, info = env.step(operator.act(observation, info))
        has_ended.set()
        sender.join()
        operator.close()
    assert "engaged" in states


def is_pressed(number: int, moved: float, begin: float) -> bool:
    """Return whether the clutch is: from the tenth message on, and by a hand that moves again and again."""
    return number > 10 if moved == 0.0 else (time.monotonic() - begin) % 1.0 > 0.2


def flood(device: Any, spoil: Callable[[], object], tell: Callable[[bool], object], together: int = TOGETHER) -> None:
    """Have a robot follow a device at rest, then one that is deflected.

    Args:
        device: The device that the hand holds.
        spoil: Has the device take a damaged message.
        tell: Sends a good message, of a device at rest, or deflected.
        together: Damaged messages between two good ones.
    """
    read = device.read

    def flooded() -> Reading | None:
        for _ in range(0 if is_deflected else together):
            spoil()
        tell(is_deflected)
        return read()

    device.read, is_deflected, readings = flooded, False, 0
    with rcs.make("Free", stepping="async", max_episode_steps=None, binary_gripper=False) as env:
        operator = Operator(env, device, has_thread=False)
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)
        start = np.array(observation["tquat"])
        for _ in range(COUNT // together):
            observation, _, _, _, info = env.step(operator.act(observation, info))
            readings = operator.feed.readings
            assert distance(start, observation["tquat"])[0] < 1e-4
        is_deflected = True
        for _ in range(60):
            observation, _, _, _, info = env.step(operator.act(observation, info))
        assert distance(start, observation["tquat"])[0] > 0.02  # and it still follows
        assert operator.feed.readings > readings > 0
        operator.close()


def test_reports_of_a_knob(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    knob = os.open(tmp_path / "knob", os.O_RDWR)
    random_ = random.Random(1)
    kinds = [struct.pack("<B3h", 1, 0, 0, 0), struct.pack("<B6h", 1, *[0] * 6), struct.pack("<B3h", 2, 0, 0, 0)]
    device = SpaceMouse(str(tmp_path / "knob"))
    read = device.read

    def spoil() -> None:  # one at a time, as the kernel gives them
        os.write(knob, broken(random_, kinds))
        read()

    flood(device, spoil, lambda is_pushed: os.write(knob, struct.pack("<B3h", 1, 200 * is_pushed, 0, 0)))
    assert device._reports.damaged >= COUNT
    os.close(knob)


def test_bytes_of_a_terminal() -> None:
    random_ = random.Random(2)
    good = [b"\x1b[113u", b"\x1b[113;1:3u", b"\x1b[1;2:2P", b"\x1b[0n", b"\x1b[?62;1c", b"\x1b[O"]
    person, program = socket.socketpair()  # a pseudo-terminal takes a millisecond for each message

    class Connected(Terminal):
        """A terminal that says when keys are released, and is not that of the program."""

        def open(self) -> None:
            self._file, self._has_releases, self.time = program.fileno(), True, time.monotonic()

        def close(self) -> None: ...

    keys = Connected([])
    device = Keyboard(keys=keys)
    read = device.read

    def spoil() -> None:
        while True:  # what reads like a key of motion cannot be told from it
            sent, probe = damaged(random_, random_.choice(good)), TerminalKeys()
            probe._rest = keys._keys._rest
            if sent and not any(event.key in MOTIONS or event.kind == "interrupt" for event in probe.feed(sent)):
                break
        person.sendall(sent)
        read()

    flood(device, spoil, lambda is_pushed: person.sendall(b"\x1b[119u" if is_pushed else b"\x1b[0n"))
    assert keys.damaged > COUNT / 20
    person.close()
    program.close()


def test_events_of_a_keyboard_of_the_robots_own(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "keys")
    file = os.open(tmp_path / "keys", os.O_RDWR)
    random_ = random.Random(3)
    keys = InputEvents(str(tmp_path / "keys"), "keyboard")
    keys._file = DeviceFile(keys.path, "keyboard", "")  # a pipe cannot be kept from other programs
    keys.open = lambda: None  # type: ignore[method-assign]
    device = Keyboard(keys=keys)
    read = device.read

    def spoil() -> None:
        kind, code, value = random_.choice([1, random_.randrange(2, 1 << 16)]), random_.randrange(1 << 16), 1
        if kind == 1 and code <= HIGHEST:  # a key; then its value is none
            value = random_.choice([-(1 << 31), -1, 3, (1 << 31) - 1])
        os.write(file, EVENT.pack(*(random_.randrange(1 << 62) for _ in range(2)), kind, code, value))
        read()

    flood(device, spoil, lambda is_pushed: os.write(file, EVENT.pack(0, 0, is_pushed, 17, 1)))
    assert keys.damaged > COUNT / 3
    os.close(file)


def test_messages_of_a_page() -> None:
    pytest.importorskip("websockets.sync.server", reason="pip install 'robot-control-stack[view]'")
    random_ = random.Random(4)

    def beat(is_pushed: bool) -> bytes:
        told = {"time": 1e3 * time.monotonic(), "is_seen": True, "keys": ["w"] if is_pushed else []}
        return json.dumps(told).encode()

    with PageLink(lambda page: None) as link:
        link.admit(1)
        link.leader, page = 1, link._pages[1]

        def hear(message: bytes) -> None:
            link._hear(1, page, message, time.monotonic())

        # The device waits 0.02 s for news at each reading.
        flood(
            Keyboard(keys=PageKeys(link)), lambda: hear(damaged(random_, beat(False))),
            lambda is_pushed: hear(beat(is_pushed)), together=1000,
        )  # fmt: skip
        assert link.damaged > COUNT / 2


@pytest.mark.hardware
@pytest.mark.parametrize(("kind", "arm"), [("dynamixel", FR3), ("feetech", SO101)])
def test_answers_of_servos(kind: str, arm: ArmDescription, tmp_path: Path) -> None:
    for name in ("serial", "scservo_sdk"):
        pytest.importorskip(name, reason="pip install 'robot-control-stack[leader]'")
    began, home = time.monotonic(), np.array(arm.home)
    with bus_of(kind, COUNTS[kind]) as bus:
        # At 2048 of each servo the follower is at home.
        angles = 2048 * STEP if kind == "dynamixel" else np.array([0.0, 0.0, 0.0, 0.0, 0.5 * STEP])
        at_home: dict[str, Any] = {"offsets": tuple((home - angles).tolist()), "near": tuple(home.tolist())}
        device: Any
        if kind == "dynamixel":
            device = gello(saved(calibrated(bus.path, signs=(1,) * 7, **at_home), tmp_path))
        else:
            device = so101_leader(saved(replace(uncalibrated(bus.path), **at_home), tmp_path))
        device.sent_damaged = 0

        def send(is_moving: bool) -> bool:
            passed = time.monotonic() - began
            # A leader without a clutch leads once it was moved and rests.
            off = 40 if passed < 1.0 else round(65 * np.sin(passed)) if is_moving else 0
            noise = 5 if passed > 3.0 and not is_moving else 0
            told = bus.tell(positions=dict.fromkeys(range(1, arm.dof + 1), 2048 + off), noise=noise)
            device.sent_damaged = sum(told["noise"].values())
            time.sleep(0.01)
            return device.sent_damaged < COUNT

        lead(device, send, lambda: device.sent_damaged, robot=arm.name)


def broken(random_: random.Random, good: list[bytes]) -> bytes:
    """Return a report that cannot be a good one; one that can moves the robot no faster than its knob may."""
    while True:
        report = damaged(random_, random_.choice(good))
        knob = KnobReports()
        if report and not knob.feed(report) and knob.damaged:
            return report


def test_messages_of_a_headset() -> None:
    pytest.importorskip("cryptography", reason="pip install 'robot-control-stack[teleop]'")
    client = pytest.importorskip("websockets.sync.client", reason="pip install 'robot-control-stack[teleop]'")
    device: Any = Quest("127.0.0.1:0")
    device.open()
    device.open, device.sent_damaged = lambda: None, 0  # the operator finds it open, for the page needs its address
    server, random_, number = device._connection, random.Random(6), 0
    where, _, code = device.url.partition("#")
    trusting = ssl.create_default_context(cafile=str(credentials.folder() / "teleop.pem"))
    page = client.connect(f"{where.replace('https', 'wss')}stream", ssl=trusting, compression=None)
    page.send(code)
    threading.Thread(target=lambda: [None for _ in page], daemon=True).start()  # echoes
    begin = time.monotonic()

    def good(y: float) -> bytes:
        nonlocal number
        number += 1
        hand = {
            "pose": [y, 1, -0.3, 0, 0, 0, 1],
            "trigger": 0.0,
            "buttons": 2 * is_pressed(number, y, begin),
            "stick": 0,
        }
        now = 1e3 * (time.monotonic() - begin)
        return json.dumps({"number": number, "time": now, "round_trip": 1, "hands": {"right": hand}}).encode()

    def send(is_moving: bool) -> bool:
        if is_moving:
            page.send(good(0.1 * np.sin(time.monotonic() - begin)))
            return True
        message = good(0.0)
        page.send(message)
        for _ in range(TOGETHER if number > 20 else 0):
            bad = damaged(random_, message)
            if decode(bad) is None:  # others are as good as sent by the page, to which TLS lets nobody else be
                page.send(bad)
                device.sent_damaged += 1
        time.sleep(0.005 if number < 20 else 0)
        return device.sent_damaged < COUNT

    lead(device, send, lambda: server.counts["damaged"])
    page.close()


def test_packets_of_a_relay() -> None:
    device: Any = Vive("127.0.0.1:0")
    device.open()
    device.open, device.sent_damaged = lambda: None, 0
    relay, random_, number = device._connection, random.Random(9), 0
    code = device.instructions.split()[-1]
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(("127.0.0.1", relay.port))
    sessions: list[bytes] = []
    threading.Thread(target=lambda: sessions.append(vive_relay.meet(link, code)), daemon=True).start()
    begin = time.monotonic()

    def good(x: float) -> bytes:
        nonlocal number
        number += 1
        matrix = (1.0, 0, 0, x, 0, 1, 0, 1, 0, 0, 1, 0)
        wand = vive_relay.Tracked(vive_relay.RIGHT, True, matrix, 4 * is_pressed(number, x, begin), 0.0, (0.0, 0.0))
        return vive_relay.pack(vive_relay.POSES, sessions[0], number, time.monotonic(), [wand], code)

    def send(is_moving: bool) -> bool:
        if not sessions:
            time.sleep(0.01)
            return True
        packet = good(0.1 * np.sin(time.monotonic() - begin) if is_moving else 0.0)
        link.send(packet)
        if is_moving:
            return True
        for _ in range(TOGETHER if number > 20 else 0):
            bad = damaged(random_, packet)
            if bad and bad != packet:
                link.send(bad)
                device.sent_damaged += 1
        time.sleep(0.005 if number < 20 else 0)
        return device.sent_damaged < COUNT

    lead(device, send, lambda: relay.counts["damaged or of another code"])
    link.close()
