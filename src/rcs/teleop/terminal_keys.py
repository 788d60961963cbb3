"""Keys of a terminal, decoded from the bytes that it sends.

Most terminals say only which key was pressed. Those with kitty's keyboard protocol also say when it is released
(https://sw.kovidgoyal.net/kitty/keyboard-protocol/).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

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
