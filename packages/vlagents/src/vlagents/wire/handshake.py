"""A websocket's handshake, both sides: by the library websockets, over a link with deadlines."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from websockets.client import ClientProtocol
from websockets.server import ServerProtocol
from websockets.uri import parse_uri

from vlagents.errors import BadMessage, ConnectionLost, Unauthorized
from vlagents.wire.link import Deadline, Link

_log = logging.getLogger(f"{__name__}.library")
_log.setLevel(logging.WARNING)  # not a line per connection

LONGEST = 16 << 10
"""Most bytes of a request or an answer."""
GET = b"GET "
"""First bytes of every request for a websocket."""
REFUSAL = b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 21\r\n\r\nThis is a websocket.\n"
"""Answer to other bytes: clients of another wire learn at once that this is a websocket."""


def accept(link: Link, deadline: Deadline, admit: Callable[[Any], tuple[int, str] | None]) -> bool:
    """Answer a request for a websocket; return whether there is one now.

    Pages in browsers are refused, because any page that a user opens could send requests. Theirs have an `Origin`,
    which a page cannot leave out; those of other clients have none.

    Args:
        link: The link to the client.
        deadline: By when the request must be there.
        admit: Takes a request (`path`, `headers`) and returns another answer (HTTP status, text), or None.

    Raises:
        BadMessage: The bytes are no request, or that of a page.
    """
    begin = bytes(link.need(len(GET), deadline))
    if begin != GET:
        link.send([memoryview(REFUSAL)], deadline)
        raise BadMessage(f"A request begins with {begin!r}; valid is {GET!r}.")
    protocol = ServerProtocol(origins=[None], logger=_log)
    protocol.receive_data(_head(link, deadline))
    requests: list[Any] = protocol.events_received()
    if not requests:
        raise BadMessage(f"This is no request for a websocket: {protocol.handshake_exc}.")
    is_page = "Origin" in requests[0].headers
    other = (403, "Pages in browsers are refused.\n") if is_page else admit(requests[0])
    response: Any = protocol.accept(requests[0]) if other is None else protocol.reject(*other)
    protocol.send_response(response)
    link.send([memoryview(data) for data in protocol.data_to_send()], deadline)
    if response.status_code == 403:
        origins = requests[0].headers.get_all("Origin")
        raise BadMessage(f"Pages in browsers are refused; this one has the Origin {origins!r:.200}.")
    return response.status_code == 101


def ask(link: Link, address: str, headers: dict[str, str], deadline: Deadline) -> None:
    """Ask a server for a websocket.

    Raises:
        Unauthorized: The token is missing or wrong.
        ConnectionLost: The server has none to give, or ends the connection, as one with TLS does.
    """
    protocol = ClientProtocol(parse_uri(address), logger=_log)
    request = protocol.connect()
    for name, value in headers.items():
        request.headers[name] = value
    protocol.send_request(request)
    link.send([memoryview(data) for data in protocol.data_to_send()], deadline)
    try:
        head = _head(link, deadline)
    except ConnectionError as error:
        tls = f" If it serves TLS, its address is wss{address[2:]}." if address.startswith("ws:") else ""
        raise ConnectionLost(f"{address} gave no answer: {str(error).rstrip('.')}.{tls}") from error
    status = head.split(b"\r\n", 1)[0].decode(errors="replace")[:200]
    number = (status.split(" ") + ["", ""])[1]
    if number == "401":
        raise Unauthorized("The token is missing or wrong.")
    if number != "101":
        raise ConnectionLost(f"{address} is no websocket: it answered {status!r}.")
    protocol.receive_data(head)
    if not protocol.events_received() or protocol.handshake_exc is not None:
        raise ConnectionLost(f"{address} is no websocket: {protocol.handshake_exc}.")


def _head(link: Link, deadline: Deadline) -> bytes:
    """Take everything up to the first empty line; what comes behind it is of the websocket already."""
    count = 0
    while count < LONGEST:
        link.need(count + 1, deadline)
        found = bytes(link.ahead[:LONGEST]).find(b"\r\n\r\n")
        if found >= 0:
            return link.take(found + 4, deadline)
        count = len(link.ahead)
    raise BadMessage(f"A handshake has more than {LONGEST} bytes.")
