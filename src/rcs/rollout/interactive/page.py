"""A page in the browser, served to this machine alone unless a host is given; to others over TLS and with a code."""

from __future__ import annotations

import asyncio
import contextlib
import html
import io
import ipaddress
import re
import socket
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, Self

from rcs_data.files.closing import Closing

from rcs.errors import InvalidSetup, MissingDependency
from rcs.rollout.interactive.gateway import Gateway
from rcs.teleop import credentials

if TYPE_CHECKING:
    import viser

LOCAL = "127.0.0.1"
"""Address of this machine alone."""

AMBIENT = 0.5
"""Ambient light in proportion to viser's own, with which light colours come out white."""

_SPECIAL = re.compile(r"[\\`*_{}\[\]()#+\-.!|~]")
"""Characters that may mean something in Markdown; those of HTML are replaced before."""


class Page(Closing):
    """A page that browsers show while its `with` block runs; any number may come and go."""

    def __init__(self, host: str, port: int) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            host: Address to listen at; `127.0.0.1` is for this machine alone. For other machines, the page is served
                over TLS to those who know the code, which is part of `url`.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        self._host, self._port = host, port
        self._server: viser.ViserServer | None = None
        self._gateway: Gateway | None = None
        self._code: str | None = None
        self._routes: dict[str, int] = {}
        """Ports of more servers behind, by path; `_build` adds them."""

    @abstractmethod
    def _build(self, server: viser.ViserServer) -> None:
        """Put everything on the page."""

    def open(self) -> None:
        """Start to serve.

        Raises:
            MissingDependency: viser is not installed.
            InvalidSetup: This machine cannot listen at the address.
        """
        is_local = _is_local(self._host)
        self._server = start_server()
        try:
            self._build(self._server)
            self._code, tls = (None, None) if is_local else (credentials.code(), credentials.tls())
            behind = self._server.get_port()
            self._gateway = Gateway(
                self._host, self._port, behind=behind, routes=self._routes, code=self._code, tls=tls
            )
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """Address of the page."""
        assert self._gateway is not None, "it is open"
        if self._code is None:
            return f"http://{'localhost' if self._host == LOCAL else _bracketed(self._host)}:{self._gateway.port}"
        host = credentials.own_addresses()[0] if self._host in ("0.0.0.0", "::") else self._host
        return f"https://{_bracketed(host)}:{self._gateway.port}/?code={self._code}"

    def close(self) -> None:
        """End the server. Closing twice is harmless."""
        if self._gateway is not None:
            self._gateway.close()
            self._gateway = None
        if self._server is not None:
            server, self._server = self._server, None
            with contextlib.redirect_stdout(io.StringIO()):  # viser reports it
                server.stop()

    def __enter__(self) -> Self:
        """Start to serve."""
        self.open()
        return self


def _is_local(host: str) -> bool:
    """Return whether only this machine reaches an address.

    Raises:
        InvalidSetup: There is no such address.
    """
    try:
        found = {entry[4][0] for entry in socket.getaddrinfo(host, 0)}
    except OSError as err:
        raise InvalidSetup(
            f"host is {host!r}, at which this machine cannot listen ({err}); valid is one of its addresses, such as "
            "127.0.0.1, or 0.0.0.0 for all of them."
        ) from err
    return all(ipaddress.ip_address(one).is_loopback for one in found)


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def start_server() -> viser.ViserServer:
    """Start a server for pages at a free port of this machine, which needs no network.

    Raises:
        MissingDependency: viser is not installed.
    """
    try:
        import viser
    except ImportError as err:
        raise MissingDependency("The browser view needs viser: pip install 'robot-control-stack[view]'.") from err

    class LocalServer(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse to open a tunnel to viser's own server on the internet, which a page may ask for."""
            return None

    with contextlib.redirect_stdout(io.StringIO()):  # viser prints its own banner
        server = LocalServer(LOCAL, 0, verbose=False)
    inner: Any = server
    inner._websock_server._broadcast_buffer.message_event = _LoopEvent()
    server.scene.configure_environment_map("warehouse", environment_intensity=AMBIENT)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


def run_script(client: Any, script: str) -> None:
    """Have one page run a script, as viser does with its own libraries."""
    from viser._messages import RunJavascriptMessage

    client._websock_connection.queue_message(RunJavascriptMessage(source=script))


def as_line(words: object) -> str:
    """Return words as Markdown that shows just these, in one line: no HTML, no links, no emphasis.

    Words of others may have them, and browsers take HTML in Markdown, and scripts in it, for what they are.
    """
    return _SPECIAL.sub(r"\\\g<0>", html.escape(" ".join(str(words).split()), quote=False))


class _LoopEvent(asyncio.Event):
    """An event that only the thread of its loop sets.

    viser sets it from the thread that shows something, too, and raises if the loop handles its waiters meanwhile; right
    after that it asks the loop to do the same, which is enough.
    """

    def set(self) -> None:
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return
        super().set()
