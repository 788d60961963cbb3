"""The address of a server: `vla://host:port`, `vlas://` with TLS, `ws://host:port`, and others."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from vlagents.errors import InvalidInput

Scheme = Literal["vla", "vlas", "ws", "wss", "gr00t", "openvla+http"]
PORTS = {
    "vla": 8090, "vlas": 8090, "ws": 8000, "wss": 8000, "gr00t": 5555, "openvla+http": 8000,
}  # fmt: skip
"""Ports where an address has none; those of other projects' wires are theirs."""


@dataclass(frozen=True)
class Address:
    """The address of a server."""

    scheme: Scheme
    host: str
    port: int

    def __str__(self) -> str:
        """Return it as it is written."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse(text: str) -> Address:
    """Read an address.

    Raises:
        InvalidInput: The text is no address.
    """
    valid = (
        "valid are vla://host:port, vlas://host:port (TLS), ws://host:port, wss://host:port, "
        "gr00t://host:port and openvla+http://host:port"
    )
    parts = urlsplit(text)
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
