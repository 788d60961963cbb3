"""A client for an address, of whatever wire."""

from __future__ import annotations

import importlib
from typing import Any

from vlagents.address import parse

CLIENTS = {
    "vla": "vlagents.client:Client",
    "vlas": "vlagents.client:Client",
    "unix": "vlagents.client:Client",
    "ws": "vlagents.websocket.client:WebsocketClient",
    "wss": "vlagents.websocket.client:WebsocketClient",
    "gr00t": "vlagents.other_wires.groot:GrootClient",
    "openvla+http": "vlagents.other_wires.openvla:OpenvlaClient",
}
"""The class of each scheme; a module is imported when it is used."""


def connect(address: str, **options: Any) -> Any:
    """Return a client of the class that the address's scheme has in `CLIENTS`.

    Args:
        address: Where the server is.
        options: As the class takes them: `token`, `timeout`, `offer` and `certificate` of all, and others.

    Raises:
        InvalidInput: The address or an option is wrong.
        ConnectionLost: No server is there.
        DeadlineExceeded: It does not answer.
        Unauthorized: The token is wrong.
        Mismatch: Robot and policy do not fit.
    """
    module, _, name = CLIENTS[parse(address).scheme].partition(":")
    return getattr(importlib.import_module(module), name)(address, **options)
