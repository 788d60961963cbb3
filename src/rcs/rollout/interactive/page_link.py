"""The link to pages: each says twenty times a second that it is seen, and which keys are held on it.

A page that is hidden, frozen, closed or cut off is not heard, and leads nothing. A thread per page listens to it; the
gateway passes connections on, so that the page needs no other port.
"""

from __future__ import annotations

import json
import logging
import math
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from rcs_data.files.closing import Closing

from rcs.extras import package_of
from rcs.teleop.input_events import Keys
from rcs.teleop.keyboard import FASTER, MOTIONS, SLOWER
from rcs.teleop.waking_clock import WakingClock

PATH = "/link"
"""Where pages reach it."""
BEAT = 0.05
"""Time between two messages of a page without news [s]."""
VALID_FOR = 0.3
"""Age of the last message from which a page is not heard [s]."""
LARGEST = 4096
"""Largest message [bytes]."""

NAMED = {
    "space": "Space", "up": "ArrowUp", "down": "ArrowDown", "left": "ArrowLeft", "right": "ArrowRight", "=": "Equal",
    "-": "Minus",
}  # fmt: skip
CODES = {NAMED.get(key, f"Key{key.upper()}"): key for key in (*MOTIONS, "space", FASTER[0], SLOWER)}
"""Keys that lead, by their place on the keyboard as browsers name it. Takes have keys of their own (`panel.KEYS`)."""


class Beat(msgspec.Struct, forbid_unknown_fields=True):
    """A message of a page."""

    time: Annotated[float, Meta(ge=0.0, le=1e12)]
    """Time of the page [ms]."""
    is_seen: bool
    """Whether the page is visible."""
    keys: Annotated[tuple[str, ...], Meta(max_length=len(CODES))]
    """Keys that are held."""


_decoder = msgspec.json.Decoder(Beat)


@dataclass
class _Page:
    token: str
    clock: WakingClock = field(default_factory=WakingClock)
    time: float = -math.inf
    """When it last spoke [s, `time.monotonic()`]."""
    is_seen: bool = False
    held: frozenset[str] = frozenset()
    pressed: list[str] = field(default_factory=list[str])
    connection: Any = None


class PageLink(Closing):
    """Hears all pages; a context manager."""

    def __init__(self, on_keys: Callable[[int], None]) -> None:
        """Listen, at a port of this machine that the gateway knows.

        Args:
            on_keys: Called by the thread of a page, with its number, when a key that leads is pressed on it.
        """
        serve: Any = package_of("view", "websockets.sync.server", "The page needs").serve
        self.leader: int | None = None
        """The page whose keys count; None for none."""
        self.damaged = 0
        """Number of messages that could not be used."""
        self._on_keys = on_keys
        self._pages: dict[int, _Page] = {}
        self._news = threading.Condition()
        self._leads = False
        quiet = logging.getLogger(f"{__name__}.connections")
        quiet.setLevel(logging.CRITICAL)  # anybody may send rubbish to a port
        self._server: Any = serve(
            self._attend, "127.0.0.1", 0, max_size=LARGEST, logger=quiet, compression=None, ping_interval=None,
            close_timeout=0.5, open_timeout=5.0,
        )  # fmt: skip
        self.port: int = self._server.socket.getsockname()[1]
        """Port at which it listens."""
        self._thread = threading.Thread(target=self._server.serve_forever, name="rcs page link", daemon=True)
        self._thread.start()

    def admit(self, page: int) -> str:
        """Expect a page, and return the script that it has to run."""
        token = secrets.token_urlsafe(16)
        with self._news:
            self._pages[page] = _Page(token)
        words = {"token": token, "codes": CODES, "beat": 1e3 * BEAT}
        script = resources.files("rcs.rollout.interactive").joinpath("page_link.js").read_text("utf-8")
        return script.replace("= WORDS;", f"= {json.dumps(words)};")

    def dismiss(self, page: int) -> None:
        """Hear a page no more."""
        with self._news:
            gone = self._pages.pop(page, None)
        if gone is not None and gone.connection is not None:
            gone.connection.close()

    def hears(self, page: int) -> bool:
        """Return whether a page is there, and seen by a person."""
        with self._news:
            own = self._pages.get(page)
            return own is not None and own.is_seen and time.monotonic() - own.time <= VALID_FOR

    def note(self, page: int) -> None:
        """Take a request of a page, which somebody has made who sees it, for a message."""
        with self._news:
            own = self._pages.get(page)
            if own is not None:
                own.time, own.is_seen = time.monotonic(), True

    def lead(self, leads: bool) -> None:
        """Have all pages take their keys for a robot's, or no longer."""
        with self._news:
            self._leads = leads
            connections = [page.connection for page in self._pages.values() if page.connection is not None]
        for connection in connections:
            self._tell(connection)

    def keys(self, seconds: float) -> tuple[float, frozenset[str], list[str]] | None:
        """Return when the leading page last spoke [s], what is held on it, and what was pressed since the last call.

        Args:
            seconds: Time to wait for news [s].

        Returns:
            None while no page leads, or while that is hidden.
        """
        with self._news:
            self._news.wait(seconds)
            page = None if self.leader is None else self._pages.get(self.leader)
            if page is None or not page.is_seen:
                return None
            pressed, page.pressed = page.pressed, []
            return page.time, page.held, pressed

    def close(self) -> None:
        """End all connections. Closing twice is harmless."""
        if self._thread.is_alive():
            self._server.shutdown()
            for page in list(self._pages):
                self.dismiss(page)
            self._thread.join()

    def _attend(self, connection: Any) -> None:
        token = connection.request.path.partition("?")[2].encode()
        with self._news:
            found = [
                (page, own) for page, own in self._pages.items() if secrets.compare_digest(own.token.encode(), token)
            ]
            if found:
                found[0][1].connection = connection
        if not found:
            connection.close(1008, "unknown page")
            return
        ((page, own),) = found
        self._tell(connection)
        for data in connection:  # ends when the connection does
            self._hear(page, own, data, time.monotonic())

    def _hear(self, page: int, own: _Page, data: str | bytes, arrived: float) -> None:
        try:
            beat = _decoder.decode(data)
        except (msgspec.MsgspecError, UnicodeError, RecursionError):
            self.damaged += 1
            return
        held = frozenset(beat.keys) & frozenset(CODES.values())
        self.damaged += len(beat.keys) > len(held)
        with self._news:
            at = own.clock.host_time(1e-3 * beat.time, arrived)
            if at is None:  # the computer of the page was asleep
                return
            risen = sorted(held - own.held)
            own.time, own.is_seen, own.held = at, beat.is_seen, held
            own.pressed = [*(own.pressed if page == self.leader else ()), *risen]  # another's asks for the lead
            self._news.notify_all()
        if risen:
            self._on_keys(page)

    def _tell(self, connection: Any) -> None:
        closed = package_of("view", "websockets.exceptions").ConnectionClosed
        try:
            connection.send(json.dumps({"leads": self._leads}))
        except (closed, OSError):
            return  # it is gone, and no longer heard


class PageKeys(Keys):
    """Keys of the page that leads, as those of a keyboard."""

    def __init__(self, link: PageLink) -> None:
        """Take the link to pages, which stays the caller's."""
        super().__init__()
        self._link = link

    def open(self) -> None:
        """Have the keys of pages lead."""
        self._link.keys(0.0)  # what was pressed before is not meant
        self._link.lead(True)

    def wait(self, seconds: float) -> None:
        """Take in what is pressed and released within a time [s]; return at the first news."""
        found, self.damaged = self._link.keys(seconds), self._link.damaged
        if found is not None:
            self.time, held, pressed = found
            self.held, self.pressed = set(held), self.pressed + pressed

    def close(self) -> None:
        """Have the keys of pages lead no longer."""
        self._link.lead(False)
