"""Where a server is: `vla://host:port`, `vlas://` with TLS, `unix:///path`, `ws://host:port`, `wss://`; and others'."""

from __future__ import annotations

import ipaddress
import os
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from vlagents.errors import InvalidInput

Scheme = Literal["vla", "vlas", "unix", "ws", "wss", "gr00t", "openvla+http"]
PORTS = {
    "vla": 8090, "vlas": 8090, "ws": 8000, "wss": 8000, "gr00t": 5555, "openvla+http": 8000,
}  # fmt: skip
"""Ports where an address has none; of others' wires, theirs."""


@dataclass(frozen=True)
class Address:
    """Where a server is."""

    scheme: Scheme
    host: str = ""
    port: int = 0
    path: str = ""
    """Of a Unix socket."""

    def __str__(self) -> str:
        """Return it as it is written."""
        if self.scheme == "unix":
            return f"unix://{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether nothing leaves this machine."""
        return self.scheme == "unix" or is_loopback(self.host)


def parse(text: str) -> Address:
    """Read an address.

    Raises:
        InvalidInput: It is none; the message says what is valid.
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


def socket_folder() -> Path:
    """Return the folder of this user's sockets, which nobody else may enter.

    Raises:
        InvalidInput: Somebody else owns it, or others may enter it.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(base) / "vlagents" if base else Path(tempfile.gettempdir()) / f"vlagents-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise InvalidInput(f"The folder {folder} is not yours alone; remove it, or set XDG_RUNTIME_DIR to one that is.")
    return folder


def socket_beside(port: int) -> Path:
    """Return where the server of a TCP port on this machine has its Unix socket."""
    return socket_folder() / f"{port}.sock"


def is_own_socket(path: Path) -> bool:
    """Return whether a path is a Unix socket of this user."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISSOCK(found.st_mode) and found.st_uid == os.getuid()
