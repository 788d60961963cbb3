"""The keys of the terminal in which the program runs.

Most terminals say only which key was pressed. Those with kitty's keyboard protocol also say when it is released
(https://sw.kovidgoyal.net/kitty/keyboard-protocol/).
"""

from __future__ import annotations

import os
import re
import select
import signal
import termios
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from rcs.errors import DeviceFault
from rcs.teleop.input_events import Keys

HELD = 0.15
"""Time for which a key counts as held without kitty's protocol [s]; a held key repeats about every 0.03 s."""
REPEATING = 0.7
"""The same for buttons [s]: the first repetition of a held key may take this long, and is no press."""
ANSWERING = 0.5
"""Time in which a terminal says which protocol it has [s]; over a network it may take a while."""
ASKING = 0.03
"""Time between two questions to a terminal that says when keys are released [s]."""

Kind = Literal["press", "repeat", "release", "answer", "identity", "protocol", "interrupt", "blur"]
KINDS: dict[str, Kind] = {"": "press", "1": "press", "2": "repeat", "3": "release"}
"""Kinds of key events by their number in kitty's protocol."""

ASK_FOR_PROTOCOL = b"\x1b[?u\x1b[c"
"""Asks for the state of kitty's protocol, and for the terminal's identity, which every terminal answers."""
BEGIN_PROTOCOL = b"\x1b[>11u\x1b[?1004h"
"""Have all keys reported as sequences (8) with their kind (2), unambiguously (1); and the loss of focus."""
END_PROTOCOL = b"\x1b[?1004l\x1b[<u"
ASK = b"\x1b[5n"
"""Asks for the status of the terminal, which it answers at once."""

SPECIAL = {27: "escape", 13: "enter", 9: "tab", 127: "backspace", 8: "backspace", 32: "space"}
"""Names of keys by their code."""
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
CONTROL = 4
"""Bit of the control key."""
LONGEST = 64
"""Most bytes of a sequence; longer ones are damaged."""

_SEQUENCE = re.compile(rb"\x1b\[([0-?]*)([ -/]*)([@-~])")
_BEGUN = re.compile(rb"\x1b(\[[0-?]*[ -/]*|O)?\Z")


@dataclass(frozen=True)
class KeyEvent:
    """A key, or an answer of the terminal."""

    kind: Kind
    """Kind of event: `interrupt` is Ctrl-C, `blur` the loss of the focus; `answer`, `identity` and `protocol` are
    answers."""
    key: str = ""
    """Name of the key, such as "w", "space" or "up"."""


class TerminalKeys:
    """Decodes bytes as they come, in pieces of any size."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._rest = b""
        self.damaged = 0
        """Number of sequences that could not be used."""

    def feed(self, data: bytes) -> list[KeyEvent]:
        """Return the events that are complete with these bytes."""
        self._rest += data
        events: list[KeyEvent] = []
        while self._rest:
            if self._rest[0] != 0x1B:
                events += _plain(self._rest[0])
                self._rest = self._rest[1:]
            elif found := _SEQUENCE.match(self._rest):
                self._rest = self._rest[found.end() :]
                events += self._sequence(found[1].decode(), found[3].decode())
            elif self._rest[1:2] == b"O" and len(self._rest) > 2:
                events += _arrow(chr(self._rest[2]))
                self._rest = self._rest[3:]
            elif _BEGUN.match(self._rest) and len(self._rest) <= LONGEST:
                break  # the rest is to come
            elif len(self._rest) > 1 and self._rest[1:2] not in (b"[", b"O"):
                events.append(KeyEvent("press", "escape"))
                self._rest = self._rest[1:]
            else:
                self.damaged += 1
                self._rest = self._rest[2:]
        return events

    def flush(self) -> list[KeyEvent]:
        """Return the key Escape if nothing has followed it; call this after a short silence."""
        if self._rest != b"\x1b":
            return []
        self._rest = b""
        return [KeyEvent("press", "escape")]

    def _sequence(self, text: str, final: str) -> list[KeyEvent]:
        if final == "n":
            return [KeyEvent("answer")] if text == "0" else []
        if final == "c" and text.startswith("?"):
            return [KeyEvent("identity")]
        if final == "u" and text.startswith("?"):
            return [KeyEvent("protocol")]
        if final == "O" and not text:
            return [KeyEvent("blur")]
        if final not in "uABCD":
            return []
        fields = [field.split(":") for field in text.split(";")]
        state = fields[1] if len(fields) > 1 else [""]
        kind = KINDS.get(state[1] if len(state) > 1 else "")
        try:
            code, held = int(fields[0][0] or "1"), int(state[0] or "1") - 1
        except ValueError:
            kind = None
            code = held = 0
        if kind is None or not 0 < code < 0x110000 or held < 0:
            self.damaged += 1
            return []
        key = ARROWS[final] if final in ARROWS else SPECIAL.get(code, chr(code).lower())
        if held & CONTROL and kind != "release":  # what was pressed before may be released now
            return [KeyEvent("interrupt")] if key == "c" and kind == "press" else []
        return [KeyEvent(kind, key)]


def _plain(code: int) -> list[KeyEvent]:
    if code == 3:
        return [KeyEvent("interrupt")]
    if code in SPECIAL:
        return [KeyEvent("press", SPECIAL[code])]
    return [KeyEvent("press", chr(code).lower())] if 0x20 < code < 0x7F else []


def _arrow(final: str) -> list[KeyEvent]:
    return [KeyEvent("press", ARROWS[final])] if final in ARROWS else []


class Terminal(Keys):
    """Keys held and pressed in the controlling terminal.

    With kitty's protocol a held key is silent. Therefore the terminal is polled, and `time` is that of the last
    question that it has answered, or of the last key: when the connection to it is lost, held keys become stale.
    """

    def __init__(self, buttons: Collection[str]) -> None:
        """Remember the buttons.

        Args:
            buttons: Keys of which every press counts once, however long they are held.
        """
        super().__init__()
        self._buttons = frozenset(buttons)
        self._file = -1
        self._keys = TerminalKeys()
        self._held: dict[str, float] = {}
        self._has_releases = False
        self._asked: float | None = None

    def open(self) -> None:
        """Have the terminal send keys at once and unseen.

        Raises:
            DeviceFault: The program has no terminal.
        """
        try:
            self._file = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
        except OSError as err:
            raise DeviceFault(
                f"The keyboard needs a terminal, and this program has none ({err.strerror}). Start it in one, or name "
                "a keyboard that is only for the robot: keyboard:/dev/input/event…"
            ) from err
        self._before = termios.tcgetattr(self._file)
        mode = termios.tcgetattr(self._file)
        mode[0] &= ~termios.ICRNL  # enter stays enter
        mode[3] &= ~(termios.ICANON | termios.ECHO)  # Ctrl-C still interrupts
        termios.tcsetattr(self._file, termios.TCSADRAIN, mode)
        self._keys, self._held, self._has_releases, self._asked = TerminalKeys(), {}, False, None
        self.held, self.pressed, self.damaged = set(), [], 0
        try:
            self._has_releases = self._says_when_released()
            if self._has_releases:
                os.write(self._file, BEGIN_PROTOCOL)
        except BaseException:
            self.close()
            raise
        self.time = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Take in what is pressed and released within a time [s]; return at the first event.

        Raises:
            DeviceFault: The terminal is gone.
        """
        if self._has_releases and self._asked is None and time.monotonic() > self.time + ASKING:
            self._asked = time.monotonic()
            self._write(ASK)
        for event in self._events(seconds):
            self._take(event)
        if not self._has_releases:
            self.time = time.monotonic()
            self._held = {key: since for key, since in self._held.items() if self.time < since + self._lasts(key)}
        self.held, self.damaged = set(self._held), self._keys.damaged

    def close(self) -> None:
        """Give the terminal its former mode, without the keys that nobody has taken."""
        if self._file < 0:
            return
        file, self._file = self._file, -1
        try:
            if self._has_releases:
                os.write(file, END_PROTOCOL)
            termios.tcsetattr(file, termios.TCSAFLUSH, self._before)
        except (OSError, termios.error):
            return  # it is gone
        finally:
            os.close(file)

    def _says_when_released(self) -> bool:
        self._write(ASK_FOR_PROTOCOL)
        end = time.monotonic() + ANSWERING
        kinds: set[str] = set()
        while "identity" not in kinds and (rest := end - time.monotonic()) > 0:
            kinds |= {event.kind for event in self._events(rest)}
        return "protocol" in kinds

    def _take(self, event: KeyEvent) -> None:
        if event.kind == "interrupt":
            os.kill(os.getpid(), signal.SIGINT)  # as the terminal would without kitty's protocol
        elif event.kind == "blur":
            self._held.clear()
        elif event.kind == "answer" and self._asked is not None:
            self.time, self._asked = max(self.time, self._asked), None
        elif event.kind == "release":
            self._held.pop(event.key, None)
        elif event.kind in ("press", "repeat"):
            if event.key not in self._held and event.kind == "press":
                self.pressed.append(event.key)
            if event.kind == "press" or event.key in self._held:
                self._held[event.key] = time.monotonic()
        if event.kind in ("press", "repeat", "release"):
            self.time = time.monotonic()

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._file, data)
        except OSError as err:
            raise DeviceFault(f"The terminal is gone: {err.strerror}. Start the program in another one.") from err

    def _lasts(self, key: str) -> float:
        return REPEATING if key in self._buttons else HELD

    def _events(self, seconds: float) -> list[KeyEvent]:
        try:
            if not select.select([self._file], [], [], seconds)[0]:
                return self._keys.flush()
            data = os.read(self._file, 4096)
        except OSError as err:
            raise DeviceFault(f"The terminal is gone: {err.strerror}. Start the program in another one.") from err
        if not data:
            raise DeviceFault("The terminal is gone: it is at its end. Start the program in another one.")
        return self._keys.feed(data)
