"""A client for an address, whatever it speaks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vlagents.address import parse
from vlagents.client import Client
from vlagents.metadata import Offer


def connect(
    address: str,
    *,
    token: str | None = None,
    timeout: float = 5.0,
    offer: Offer | None = None,
    certificate: str | Path | None = None,
    **options: Any,
) -> Any:
    """Return a client of the class that the address wants.

    That is a `Client` for `vla://`, `vlas://` and `unix://`, a `WebsocketClient` for `ws://` and `wss://`, a
    `GrootClient` for `gr00t://`, and an `OpenvlaClient` for `openvla+http://`.

    Args:
        address: Where the server is.
        token: What it wants to hear.
        timeout: How long an answer may take [s].
        offer: What the robot shows and takes; None to compare nothing.
        certificate: File with the certificate that the server's must be signed by.
        options: Passed on to the client's class.
    """
    scheme = parse(address).scheme
    if scheme in ("gr00t", "openvla+http"):
        from vlagents.other_wires.groot import GrootClient
        from vlagents.other_wires.openvla import OpenvlaClient

        kinds = {"gr00t": GrootClient, "openvla+http": OpenvlaClient}
        return kinds[scheme](address, token=token, timeout=timeout, offer=offer, **options)
    if scheme in ("ws", "wss"):
        from vlagents.websocket import WebsocketClient

        return WebsocketClient(address, token=token, timeout=timeout, offer=offer, certificate=certificate, **options)
    return Client(address, token=token, timeout=timeout, offer=offer, certificate=certificate, **options)
