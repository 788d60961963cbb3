"""The address of a server: `vla://host:port`, `vlas://` with TLS, `unix:///path`, `ws://host:port`, and others."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from vlagents.errors import InvalidInput

Scheme = Literal["vla", "vlas", "unix", "ws", "wss", "gr00t", "openvla+http"]
PORTS = {
    "vla": 8090, "vlas": 8090, "ws": 8000, "wss": 8000, "gr00t": 5555, "openvla+http": 8000,
}  # fmt: skip
"""Ports where an address has none; those of other projects' wires are theirs."""


@dataclass(frozen=True)
class Address:
    """Where a server is."""

    scheme: Scheme
    host: str = ""
    port: int = 0
    path: str = ""
    """Path of a Unix socket."""

    def __str__(self) -> str:
        """Return it as it is written."""
        if self.scheme == "unix":
            return f"unix://{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse(text: str) -> Address:
    """Read an address.

    Raises:
        InvalidInput: The text is no address.
    """
    valid = (
        "valid are vla://host:port, vlas://host:port (TLS), unix:///path, ws://host:port, wss://host:port, "
        "gr00t://host:port and openvla+http://host:port"
    )
    parts = urlsplit(text)
    if parts.scheme == "unix" and parts.path:
        return Address("unix", path=parts.path)
    try:
        port = parts.port
    except ValueError as error:
        raise InvalidInput(f"The address {text!r} has no valid port; {valid}.") from error
    if parts.scheme not in PORTS or not parts.hostname or parts.path.strip("/") or parts.query:
        raise InvalidInput(f"The address is {text!r}; {valid}.")
    scheme: Scheme = parts.scheme  # type: ignore[assignment]
    return Address(scheme, host=parts.hostname, port=PORTS[scheme] if port is None else port)


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine, and not to be reached from another."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
