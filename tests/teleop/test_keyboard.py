"""The keyboard: the terminal's keys, on a pseudo-terminal that the test plays."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rcs.errors import InvalidSetup
from rcs.teleop.keyboard import MOTIONS, Keyboard
from rcs.teleop.terminal import ASK, ASK_FOR_PROTOCOL, BEGIN_PROTOCOL, END_PROTOCOL, KeyEvent, TerminalKeys

READ = Path(__file__).parent / "read_device.py"
PEER = 0x5441
"""TIOCGPTPEER: opens the other end of a pseudo-terminal."""


def keys(*pieces: bytes) -> list[tuple[str, str]]:
    decoder = TerminalKeys()
    return [(event.kind, event.key) for piece in pieces for event in decoder.feed(piece)]


def test_kittys_protocol_says_when_keys_are_pressed_and_released() -> None:
    sent = b"\x1b[119u\x1b[119;1:2u\x1b[119;2:3u\x1b[1;1:3A\x1b[32u\x1b[99;5u\x1b[O"
    assert keys(sent) == [
        ("press", "w"), ("repeat", "w"), ("release", "w"), ("release", "up"), ("press", "space"), ("interrupt", ""),
        ("blur", ""),
    ]  # fmt: skip


def test_a_key_that_was_pressed_before_control_is_released_with_it() -> None:
    held = b"\x1b[119u\x1b[119;5:2u\x1b[119;5:3u"  # w, then Ctrl, and w is let go first
    assert keys(held) == [("press", "w"), ("release", "w")]


def test_bytes_may_come_in_any_pieces() -> None:
    sent = b"w\x1b[119;1:3u\x1bOA\x1b[?64;1c\x1b[0n\x1b[?11u q"
    assert keys(*(sent[at : at + 1] for at in range(len(sent)))) == keys(sent)
    assert [kind for kind, _ in keys(sent)] == [
        "press", "release", "press", "identity", "answer", "protocol", "press", "press",
    ]  # fmt: skip


def test_escape_is_a_key_if_nothing_follows() -> None:
    decoder = TerminalKeys()
    assert decoder.feed(b"\x1b") == []
    assert decoder.flush() == [KeyEvent("press", "escape")]
    assert decoder.feed(b"\x1b") + decoder.feed(b"w") == [KeyEvent("press", "escape"), KeyEvent("press", "w")]


def test_damaged_sequences_are_left_out_and_counted() -> None:
    decoder = TerminalKeys()
    sent = b"\x1b[0u" + b"\x1b[119;1:9u" + b"\x1b[1:;;;:u" + b"\x1b[" + b"1" * 200 + b"u" + b"\x1b[99999999u"
    events = decoder.feed(sent) + decoder.flush()
    assert [event for event in events if event.key == "w" or event.kind == "release"] == []
    assert decoder.damaged >= 4


class Player:
    """A terminal and the person at it: the other end of the program's pseudo-terminal."""

    def __init__(self, readings: int, *, has_protocol: bool) -> None:
        self.has_protocol, self.is_answering = has_protocol, True
        self._readings = os.fdopen(readings)
        self.pid, self._terminal = pty.fork()
        if self.pid == 0:
            out = os.open(f"/proc/{os.getppid()}/fd/{readings}", os.O_WRONLY)
            os.dup2(out, 1)
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
            program = [sys.executable, str(READ), "rcs.teleop.keyboard", "Keyboard", "", "30"]
            os.execve(sys.executable, program, environment)
        self.shown = b""
        self._kept = fcntl.ioctl(self._terminal, PEER, os.O_RDWR | os.O_NOCTTY)  # the terminal outlives the program
        self.lines: list[dict[str, Any]] = []
        self._rest = ""

    def send(self, data: bytes) -> None:
        os.write(self._terminal, data)

    def play(self, is_done: Callable[[], bool], seconds: float = 20.0) -> None:
        """Answer the program until something is so."""
        end = time.monotonic() + seconds
        while not is_done():
            assert time.monotonic() < end, (self.lines[-3:], self.shown)
            for file in select.select([self._terminal, self._readings], [], [], 0.05)[0]:
                if file is self._readings:
                    self._rest += os.read(self._readings.fileno(), 1 << 16).decode()
                    *lines, self._rest = self._rest.split("\n")
                    self.lines += map(json.loads, lines)
                    continue
                data = os.read(self._terminal, 4096)
                self.shown += data
                if ASK_FOR_PROTOCOL in data:
                    self.send((b"\x1b[?0u" if self.has_protocol else b"") + b"\x1b[?62;22c")
                if self.is_answering and ASK in data:
                    self.send(b"\x1b[0n")

    def for_a_while(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self.play(lambda: time.monotonic() > end)

    @property
    def hand(self) -> dict[str, Any]:
        return self.lines[-1].get("hands", {}).get("right", {"twist": [0.0] * 6, "buttons": []})

    def moves(self, *twist: float) -> Callable[[], bool]:
        return lambda: self.hand["twist"] == pytest.approx([*twist, *[0.0] * (6 - len(twist))])

    def count(self, button: str) -> int:
        """Return how often a button was pressed."""
        held = [button in line["hands"]["right"]["buttons"] for line in self.lines if "hands" in line]
        return sum(now and not before for now, before in zip(held, [False, *held], strict=False))

    def mode(self) -> list[Any]:
        return termios.tcgetattr(self._terminal)

    def close(self) -> None:
        os.close(self._kept)
        os.close(self._terminal)
        self._readings.close()
        os.waitpid(self.pid, 0)


@pytest.fixture
def play(tmp_path: Path) -> Iterator[Callable[[bool], Player]]:
    players: list[Player] = []

    def start(has_protocol: bool) -> Player:
        reader, writer = os.pipe()
        os.close(writer)  # the program opens it anew
        os.close(reader)
        fifo = tmp_path / "readings"
        os.mkfifo(fifo)
        player = Player(os.open(fifo, os.O_RDWR), has_protocol=has_protocol)
        players.append(player)
        player.play(lambda: len(player.lines) > 1)
        assert player.lines[0] == {"open": True}
        return player

    yield start
    for player in players:
        player.close()


def test_with_kittys_protocol_a_key_acts_until_it_is_released(play) -> None:
    player = play(True)
    player.send(b"\x1b[119u")
    player.play(player.moves(0.1))
    assert player.hand["buttons"] == ["clutch"]
    player.send(b"\x1b[97u")
    player.play(player.moves(0.1, 0.1))
    player.for_a_while(0.5)  # held keys are silent
    assert player.moves(0.1, 0.1)()
    player.send(b"\x1b[119;1:3u")
    player.play(player.moves(0.0, 0.1))
    player.send(b"\x1b[O")  # another window has the keyboard now
    player.play(player.moves())
    assert player.hand["buttons"] == []
    assert BEGIN_PROTOCOL in player.shown


def test_a_short_press_is_seen_once(play) -> None:
    player = play(True)
    player.send(b"\x1b[32u\x1b[32;1:3u")
    player.play(lambda: player.count("gripper") == 1)
    player.for_a_while(0.2)
    assert player.count("gripper") == 1


def test_keys_held_while_the_connection_to_the_terminal_is_lost_become_stale(play) -> None:
    player = play(True)
    player.send(b"\x1b[119u")
    player.play(player.moves(0.1))
    assert max(line["age"] for line in player.lines if "age" in line) < 1.0
    player.is_answering = False
    player.for_a_while(0.2)
    count = len(player.lines)
    player.for_a_while(0.3)
    assert len(player.lines) == count
    player.is_answering = True
    player.send(b"\x1b[0n")  # what was under way comes at last
    player.play(lambda: len(player.lines) > count + 2 and player.lines[-1]["age"] < 0.15)


def test_without_the_protocol_a_key_acts_while_it_repeats(play) -> None:
    player = play(False)
    assert BEGIN_PROTOCOL not in player.shown
    for _ in range(12):
        player.send(b"r")
        player.for_a_while(0.03)
    assert player.moves(0.0, 0.0, 0.1)()
    player.play(player.moves())
    assert player.hand["buttons"] == []


def test_without_the_protocol_a_held_button_is_one_press(play) -> None:
    player = play(False)
    player.send(b" ")
    player.for_a_while(0.5)  # the delay before the first repetition
    for _ in range(5):
        player.send(b" ")
        player.for_a_while(0.03)
    player.play(lambda: "gripper" not in player.hand["buttons"])
    assert player.count("gripper") == 1


def test_without_the_protocol_enter_is_enter(play) -> None:
    player = play(False)
    player.send(b"\r")
    player.play(lambda: "start" in player.hand["buttons"])


def test_the_terminal_gets_its_mode_back_also_after_an_interrupt(play) -> None:
    player = play(True)
    assert not player.mode()[3] & (termios.ICANON | termios.ECHO)
    player.send(b"\x1b[99;5u")
    player.play(lambda: END_PROTOCOL in player.shown)
    player.for_a_while(0.3)
    assert player.mode()[3] & termios.ICANON
    assert player.mode()[3] & termios.ECHO


def test_each_axis_has_two_keys_of_a_hand_and_the_arrows_are_the_first_four() -> None:
    letters = [MOTIONS[key] for key in "wsadrfouikjl"]
    assert letters == [(axis, sign) for axis in range(6) for sign in (1, -1)]
    assert [MOTIONS[key] for key in ("up", "down", "left", "right")] == letters[:4]


def test_speed_keys_keep_within_bounds(play) -> None:
    player = play(True)
    for key, bound in ((61, 0.25), (45, 0.01)):
        player.send(b"\x1b[%du\x1b[%d;1:3u" % (key, key) * 9 + b"\x1b[119u")
        player.play(player.moves(bound))
        player.send(b"\x1b[119;1:3u")


def test_keys_without_a_meaning_are_counted_and_move_nothing() -> None:
    keys: Any = SimpleNamespace(
        held=set(), pressed=["q", "w", "57"], damaged=1, time=time.monotonic(), open=lambda: None, wait=time.sleep,
        close=lambda: None,
    )  # fmt: skip
    with Keyboard(keys=keys) as device:
        device.open()
        reading = device.read()
        assert reading is not None
        assert reading.counts == {"damaged": 1, "unknown key": 2}
        assert reading.hands["right"].twist == pytest.approx([0.1, 0, 0, 0, 0, 0])


def test_without_a_terminal_the_fault_names_the_other_way(run_program) -> None:
    found = run_program(
        """
        import os
        os.setsid()
        from rcs.teleop.keyboard import MOTIONS, Keyboard
        Keyboard().open()
        """
    )
    assert "DeviceFault: The keyboard needs a terminal" in found.stderr
    assert "keyboard:/dev/input/event" in found.stderr


def test_an_address_that_is_no_path_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="/dev/input/"):
        Keyboard("evdev")


def test_ctrl_c_is_a_signal_without_the_protocol() -> None:
    assert keys(b"\x03") == [("interrupt", "")]
