"""A page in the browser, served to this machine alone unless a host is given."""

from __future__ import annotations

import contextlib
import io
import socket
from abc import abstractmethod
from typing import TYPE_CHECKING, Self

from rcs_data.closing import Closing

from rcs.errors import InvalidSetup, MissingDependency

if TYPE_CHECKING:
    import viser

AMBIENT = 0.5
"""Ambient light in proportion to viser's own, with which light colours come out white."""


class Page(Closing):
    """A page that browsers show while its `with` block runs; any number may come and go."""

    def __init__(self, host: str, port: int) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            host: Address to listen at; `127.0.0.1` is for this machine alone. There is no password.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        self._host, self._port = host, port
        self._server: viser.ViserServer | None = None

    @abstractmethod
    def _build(self, server: viser.ViserServer) -> None:
        """Put everything on the page."""

    def open(self) -> None:
        """Start to serve.

        Raises:
            MissingDependency: viser is not installed.
            InvalidSetup: This machine cannot listen at the address.
        """
        self._server = start_server(self._host, self._port)
        try:
            self._build(self._server)
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """Address of the page."""
        assert self._server is not None, "it is open"
        host = "localhost" if self._host in ("0.0.0.0", "::", "127.0.0.1") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    def close(self) -> None:
        """End the server. Closing twice is harmless."""
        if self._server is not None:
            server, self._server = self._server, None
            with contextlib.redirect_stdout(io.StringIO()):  # viser reports it
                server.stop()

    def __enter__(self) -> Self:
        """Start to serve."""
        self.open()
        return self


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
