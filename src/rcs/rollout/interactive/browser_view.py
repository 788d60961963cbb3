"""A session on a page in the browser: the scene, a target to drag for every robot, and a panel.

Pages only ask: what they ask for waits in a queue for the one thread that uses the session, and what they see is sent
by that thread. So any number of pages may be open, and come and go.
"""

from __future__ import annotations

import contextlib
import io
import logging
import queue
import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, MissingDependency, RcsError
from rcs.rollout.interactive.panel import Panel
from rcs.rollout.interactive.session import Session
from rcs.sim.browser_scene import BrowserScene

if TYPE_CHECKING:
    import viser

IDLE = 0.02
"""Time between two looks at what pages ask for, while nothing moves [s]."""

AMBIENT = 0.5
"""Light from all around in proportion to viser's own, with which light colours come out white."""

_log = logging.getLogger(__name__)


class BrowserView:
    """Serves a session to browsers; a context manager. The session is the caller's until another setup is chosen."""

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            session: What is shown and led.
            host: Address to listen at; the default is for this machine alone. There is no password.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        self.session = session
        self._host, self._port = host, port
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._server: viser.ViserServer | None = None
        self._scene: BrowserScene | None = None
        self._panel: Panel | None = None

    def open(self) -> None:
        """Start to serve.

        Raises:
            MissingDependency: viser is not installed.
            InvalidSetup: This machine cannot listen at the address.
        """
        server = start_server(self._host, self._port)
        self._server = server
        try:
            self._build()
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """Address of the page."""
        assert self._server is not None, "it is open"
        host = "localhost" if self._host in ("0.0.0.0", "::", "127.0.0.1") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    def turn(self) -> None:
        """Do what was asked, make a step if the session is playing, and show what has changed."""
        self._answer()
        if not self.session.advance():
            time.sleep(IDLE)
        assert self._scene is not None, "it is open"
        assert self._panel is not None, "it is open"
        self._scene.show()
        self._panel.show()

    def run(self, is_done: Callable[[], bool] = lambda: False) -> None:
        """Serve until something is done, or for ever.

        Args:
            is_done: Asked after every turn.
        """
        while not is_done():
            self.turn()

    def close(self) -> None:
        """End the server. Closing twice is harmless."""
        if self._server is not None:
            server, self._server = self._server, None
            with contextlib.redirect_stdout(io.StringIO()):  # it says so
                server.stop()

    def ask(self, request: Callable[[], None]) -> None:
        """Have something done by the thread of the session; may be called from any thread.

        Args:
            request: What to do. An error of this library that it raises is shown on the page.
        """
        self._asked.put(request)

    def _answer(self) -> None:
        while True:
            try:
                request = self._asked.get_nowait()
            except queue.Empty:
                return
            try:
                request()
            except RcsError as err:
                _log.warning("%s: %s", type(err).__name__, err)
                if self._panel is not None:
                    self._panel.tell(f"{type(err).__name__}: {err}")

    def _build(self) -> None:
        """Put the scene and the panel of the present session on the page."""
        assert self._server is not None, "it is open"
        self._server.scene.reset()
        self._server.gui.reset()
        robots = list(self.session.env.robots.values())
        self._scene = BrowserScene(self._server, self.session.world, robots)
        self._panel = Panel(self._server, self.session, self._scene, ask=self.ask, change=self._change)

    def _change(self, setup: Setup) -> None:
        """Simulate another setup; if it cannot be made, the present one goes on."""
        session = Session(setup, seed=self.session.seed)
        self.session.close()
        self.session = session
        self._build()

    def __enter__(self) -> Self:
        """Start to serve."""
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the server."""
        self.close()


def start_server(host: str, port: int) -> viser.ViserServer:
    """Start a server for pages that needs no network but the address it listens at.

    Args:
        host: Address to listen at.
        port: Port to listen at, or the next one that is free; 0 for any.

    Raises:
        MissingDependency: viser is not installed.
        InvalidSetup: This machine cannot listen at the address.
    """
    try:
        import viser
    except ImportError as err:
        raise MissingDependency("The browser view needs viser: pip install 'robot-control-stack[view]'.") from err

    class LocalServer(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse to open a tunnel to viser's own server on the internet, which a page may ask for."""
            return None

    try:  # viser would try all ports of an address that is not there
        socket.create_server((host, 0), family=socket.getaddrinfo(host, 0)[0][0]).close()
    except OSError as err:
        raise InvalidSetup(
            f"host is {host!r}, at which this machine cannot listen ({err}); valid is one of its addresses, such as "
            "127.0.0.1, or 0.0.0.0 for all of them."
        ) from err
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints its own banner
        server = LocalServer(host, port, verbose=False)
    server.scene.configure_environment_map("warehouse", environment_intensity=AMBIENT)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server
