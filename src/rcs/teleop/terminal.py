"""The keys of the terminal in which the program runs."""

from __future__ import annotations

import os
import select
import signal
import termios
import time
from collections.abc import Collection

from rcs.errors import DeviceFault
from rcs.teleop.input_events import Keys
from rcs.teleop.terminal_keys import ASK, ASK_FOR_PROTOCOL, BEGIN_PROTOCOL, END_PROTOCOL, KeyEvent, TerminalKeys

HELD = 0.15
"""Time for which a key counts as held without kitty's protocol [s]; a held key repeats about every 0.03 s."""
REPEATING = 0.7
"""The same for buttons [s]: the first repetition of a held key may take this long, and is no press."""
ANSWERING = 0.5
"""Time in which a terminal says which protocol it has [s]; over a network it may take a while."""
ASKING = 0.03
"""Time between two questions to a terminal that says when keys are released [s]."""


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
