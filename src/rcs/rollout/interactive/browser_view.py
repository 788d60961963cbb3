"""A session on a page in the browser: the scene, a target to drag for every robot, and a panel.

Pages put requests into a queue for the one thread that uses the session; that thread also sends what they show. The
page that leads has to be heard: when it is hidden, frozen, cut off or closed, the robots brake and stay.
"""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from rcs.errors import RcsError
from rcs.rollout.interactive.page import Page, run_script
from rcs.rollout.interactive.page_link import PATH, PageKeys, PageLink
from rcs.rollout.interactive.panel import Panel
from rcs.rollout.interactive.session import Session
from rcs.sim.browser_scene import BrowserScene
from rcs.teleop import Keyboard
from rcs.teleop.takeover import people_of

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
            host: Address to listen at; the default is for this machine alone; others need the code of `url`.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        super().__init__(host, port)
        self.session = session
        self._requests: queue.SimpleQueue[tuple[Callable[[], None], int | None]] = queue.SimpleQueue()
        self._link: PageLink | None = None
        self._episodes = session.episodes
        self._scene: BrowserScene | None = None
        self._panel: Panel | None = None

    @property
    def leader(self) -> int | None:
        """The page that leads: the first that made a request, as long as it is heard; None for none."""
        return None if self._link is None else self._link.leader

    def update(self) -> None:
        """Handle requests, make a step if the session is playing, and show what has changed."""
        assert self._link is not None, "it is open"
        assert self._scene is not None, "it is open"
        assert self._panel is not None, "it is open"
        if self.leader is not None and not self._link.hears(self.leader):
            self._let_go(self._link)
        while not self._requests.empty():
            request, page = self._requests.get()
            if page is not None and (refusal := self._refusal(self._link, page)):
                self._panel.refuse(refusal)
                continue
            try:
                request()
            except RcsError as err:
                _tell(err, self._panel)
        if not self._advance(self._panel):
            time.sleep(IDLE)
        if self.session.episodes != self._episodes:
            self._episodes = self.session.episodes
            self._scene.rebuild()
            self._panel.begin()
        self._scene.show()
        self._panel.show()

    def run(self, is_done: Callable[[], bool] = lambda: False) -> None:
        """Serve for ever, or until `is_done`, called after every update, returns True."""
        while not is_done():
            self.update()

    def submit(self, request: Callable[[], None], page: int | None = None) -> None:
        """Let the thread of the session handle a request; may be called from any thread.

        Args:
            request: Called by that thread. An error of this library that it raises is shown on the page.
            page: The page of a request that only the leading page may make; None for any other request.
        """
        self._requests.put((request, page))

    def _ask(self, request: Callable[[], None], page: int | None) -> None:
        """Submit a request of a person who uses a page; so also one that is slow at drawing can pause the robots."""
        if self._link is not None and page is not None:
            self._link.note(page)
        self.submit(request, page)

    def _advance(self, panel: Panel) -> bool:
        """Have the session go on, and return whether it does; a request of an agent that is refused is shown."""
        try:
            return self.session.advance()
        except RcsError as err:
            _tell(err, panel)
            return True

    def _refusal(self, link: PageLink, page: int) -> str:
        """Give a page the lead, or return why not."""
        if not link.hears(page):
            return "This page is not heard, so it cannot lead; reload it if that stays so."
        if link.leader is None:
            link.leader = page
        return "" if link.leader == page else "Another page leads; this one shows. Close that one to lead from here."

    def _let_go(self, link: PageLink) -> None:
        """Have the robots that the page led stay; the next page with a request leads."""
        link.leader = None
        has_device = self.session.operator is None and bool(people_of(self.session.agent))
        try:
            self.session.release()
        except RcsError as err:  # of an agent that is closed; the robots brake
            _log.warning("%s: %s", type(err).__name__, err)
        if self._panel is not None:
            rest = "the device leads on" if has_device else "the robots stay"
            self._panel.show_message(f"The page that led is hidden, closed or cut off: {rest}.")

    def _build(self, server: viser.ViserServer) -> None:
        link = self._link = PageLink(lambda page: self.submit(_nothing, page))
        self._routes[PATH] = link.port
        self._scene = BrowserScene(server, self.session.world, list(self.session.env.robots.values()))
        self._panel = Panel(server, self.session, self._ask, Keyboard(keys=PageKeys(link)))

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            run_script(client, link.admit(client.client_id))

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            link.dismiss(client.client_id)

    def close(self) -> None:
        """End the server. Closing twice is harmless."""
        super().close()
        if self._link is not None:
            self._link.close()


def _tell(err: RcsError, panel: Panel) -> None:
    _log.warning("%s: %s", type(err).__name__, err)
    panel.show_message(f"{type(err).__name__}: {err}")


def _nothing() -> None:
    """The request of a pressed key, which is for the lead alone."""
