"""A session on a page in the browser: the scene, a target to drag for every robot, and a panel.

Pages put requests into a queue for the one thread that uses the session; that thread also sends what they show.
"""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from rcs.errors import RcsError
from rcs.rollout.interactive.page import Page
from rcs.rollout.interactive.panel import Panel
from rcs.rollout.interactive.session import Session
from rcs.sim.browser_scene import BrowserScene

if TYPE_CHECKING:
    import viser

IDLE = 0.02
"""Time between two looks at the queue while nothing moves [s]."""

_log = logging.getLogger(__name__)


class BrowserView(Page):
    """Serves a session to browsers; a context manager. The session is the caller's."""

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            session: The session to show and control.
            host: Address to listen at; the default is for this machine alone. There is no password.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        super().__init__(host, port)
        self.session = session
        self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._scene: BrowserScene | None = None
        self._panel: Panel | None = None

    def update(self) -> None:
        """Handle requests, make a step if the session is playing, and show what has changed."""
        assert self._scene is not None, "it is open"
        assert self._panel is not None, "it is open"
        while not self._requests.empty():
            try:
                self._requests.get()()
            except RcsError as err:
                _log.warning("%s: %s", type(err).__name__, err)
                self._panel.show_message(f"{type(err).__name__}: {err}")
        if not self.session.advance():
            time.sleep(IDLE)
        self._scene.show()
        self._panel.show()

    def run(self, is_done: Callable[[], bool] = lambda: False) -> None:
        """Serve for ever, or until `is_done`, called after every update, returns True."""
        while not is_done():
            self.update()

    def submit(self, request: Callable[[], None]) -> None:
        """Let the thread of the session handle a request; may be called from any thread.

        Args:
            request: Called by that thread. An error of this library that it raises is shown on the page.
        """
        self._requests.put(request)

    def _build(self, server: viser.ViserServer) -> None:
        self._scene = BrowserScene(server, self.session.world, list(self.session.env.robots.values()))
        self._panel = Panel(server, self.session, self._scene, self.submit)
