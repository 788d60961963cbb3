"""Inputs whose other end is stopped and killed in mid-motion: nothing that they said is taken for new."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from rcs.teleop import credentials, vive_relay
from rcs.teleop.device import InputDevice, Reading
from rcs.teleop.feed import Feed
from rcs.teleop.gello import gello
from rcs.teleop.leader import LeaderCalibration
from rcs.teleop.quest import Quest
from rcs.teleop.so101_leader import so101_leader
from rcs.teleop.spacemouse import SpaceMouse
from rcs.teleop.vive import Vive

STOPS = 20
"""Random moments at which the other end is stopped; it is killed at the last one."""
LATE = 0.1
"""Time after `valid_for` within which a reading has to be gone [s]."""
BACK = 15.0
"""Time in which it is there again [s]."""

KNOB = """
    import struct, sys, time
    with open(sys.argv[1], "wb", buffering=0) as knob:
        while True:
            knob.write(struct.pack("<B3h", 1, 100, 200, 0))
            time.sleep(0.01)
"""
PAGE = """
    import json, ssl, sys, time
    from websockets.sync.client import connect
    address, code, certificate = sys.argv[1:]
    with connect(address, ssl=ssl.create_default_context(cafile=certificate), compression=None) as page:
        page.send(code)
        begin = time.monotonic()
        for number in range(10 ** 6):
            at = time.monotonic() - begin
            hand = {"pose": [0, 0, -0.1 * at, 0, 0, 0, 1], "trigger": 0, "buttons": 2, "stick": 0}
            page.send(json.dumps({"number": number, "time": 1e3 * at, "round_trip": 0, "hands": {"right": hand}}))
            time.sleep(1 / 72)
"""


@contextmanager
def program(*words: str, lines: int = 0) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the other end; give it with the first line that it prints, if it prints one."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE} if lines else {"stdout": subprocess.DEVNULL}
    process = subprocess.Popen([sys.executable, *words], text=True, **pipes)  # pyright: ignore[reportCallIssue, reportArgumentType]
    try:
        yield process, process.stdout.readline().strip() if lines and process.stdout is not None else ""
    finally:
        process.kill()
        process.wait()


def spacemouse(stack: ExitStack, folder: Path) -> tuple[InputDevice, subprocess.Popen[str]]:
    os.mkfifo(folder / "knob")
    device = stack.enter_context(SpaceMouse(str(folder / "knob")))
    process, _ = stack.enter_context(program("-c", textwrap.dedent(KNOB), str(folder / "knob")))
    return device, process


def quest(stack: ExitStack, folder: Path) -> tuple[InputDevice, subprocess.Popen[str]]:
    pytest.importorskip("websockets.sync.client", reason="pip install 'robot-control-stack[teleop]'")
    pytest.importorskip("cryptography", reason="pip install 'robot-control-stack[teleop]'")
    device = stack.enter_context(Quest("127.0.0.1:0"))
    device.open()
    where, _, code = device.url.partition("#")
    certificate = str(credentials.folder() / "teleop.pem")
    address = f"{where.replace('https', 'wss')}stream"
    process, _ = stack.enter_context(program("-c", textwrap.dedent(PAGE), address, code, certificate))
    return Opened(device), process


def vive(stack: ExitStack, folder: Path) -> tuple[InputDevice, subprocess.Popen[str]]:
    device = stack.enter_context(Vive("127.0.0.1:0"))
    device.open()
    relay = str(Path(__file__).parent / "relay_alone.py")
    process, _ = stack.enter_context(program("-S", relay, vive_relay.__file__, *device.instructions.split()[-2:]))
    return Opened(device), process


def leader_of(kind: str) -> Callable[[ExitStack, Path], tuple[InputDevice, subprocess.Popen[str]]]:
    def leader(stack: ExitStack, folder: Path) -> tuple[InputDevice, subprocess.Popen[str]]:
        for name in ("serial", "scservo_sdk"):
            pytest.importorskip(name, reason="pip install 'robot-control-stack[leader]'")
        file = str(Path(__file__).parent / "leader_bus.py")
        process, port = stack.enter_context(program(file, kind, "6" if kind == "feetech" else "3", lines=1))
        if kind == "feetech":
            return stack.enter_context(so101_leader(port)), process
        zeros = {"signs": (1, 1), "offsets": (0.0, 0.0), "near": (0.0, 0.0), "closed": 0.0, "opened": 1.0}
        LeaderCalibration(address=port, servos=(1, 2, 3), **zeros).write(folder / "leader.json")
        return stack.enter_context(gello(str(folder / "leader.json"))), process

    return leader


class Opened(InputDevice):
    """A device that is open already: its address had to be known before its other end was started."""

    def __init__(self, device: InputDevice) -> None:
        self._device = device
        self.valid_for, self.hands, self.has_clutch = device.valid_for, device.hands, device.has_clutch

    def open(self) -> None:
        pass

    def read(self) -> Reading | None:
        return self._device.read()

    def close(self) -> None:
        self._device.close()


INPUTS = [
    pytest.param(spacemouse, id="spacemouse"),
    pytest.param(vive, id="vive"),
    pytest.param(quest, id="quest", marks=pytest.mark.extras),
    pytest.param(leader_of("feetech"), id="so101_leader", marks=pytest.mark.hardware),
    pytest.param(leader_of("dynamixel"), id="gello", marks=pytest.mark.hardware),
]


@pytest.mark.slow
@pytest.mark.parametrize("make", INPUTS)
def test_a_reading_is_gone_soon_after_its_input_goes_silent(make, tmp_path: Path) -> None:
    random_ = random.Random(7)
    with ExitStack() as stack:
        device, process = make(stack, tmp_path)
        feed = stack.enter_context(Feed(device))
        feed.open()
        slowest = 0.0
        for stop in range(STOPS):
            end = time.monotonic() + BACK
            while feed.poll().reading is None:
                assert time.monotonic() < end, (stop, feed.poll().why, dict(feed.counts))
                time.sleep(0.005)
            time.sleep(random_.uniform(0.0, 0.1))
            os.kill(process.pid, signal.SIGKILL if stop == STOPS - 1 else signal.SIGSTOP)
            stopped = time.monotonic()
            while feed.poll().reading is not None:
                time.sleep(0.002)
                assert time.monotonic() < stopped + 2.0
            slowest = max(slowest, time.monotonic() - stopped)
            begin = time.monotonic()
            while time.monotonic() < begin + 0.15:  # and it does not come back by itself
                assert feed.poll().reading is None
                time.sleep(0.005)
            if stop < STOPS - 1:
                os.kill(process.pid, signal.SIGCONT)
        print(json.dumps({"input": type(device).__name__, "slowest": slowest, "valid_for": device.valid_for}))  # noqa: T201
        assert slowest <= device.valid_for + LATE
