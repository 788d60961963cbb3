"""OpenVLA's wire, both ways: HTTP `POST /act` with JSON, where arrays are json-numpy's maps.

Layout as in OpenVLA's `vla-scripts/deploy.py`: `{"image": uint8 (height, width, 3), "instruction": str, "unnorm_key"?}`
is the request, or `{"encoded": JSON of that}`; the answer is one action, (7,), or a chunk, (horizon, size), which after
`encoded` is JSON in a string. An array is `{"__numpy__": base64, "dtype", "shape"}`. A failure is "error".
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import http.client
import json
import logging
import socket
import threading
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, ConnectionLost, InvalidInput, PolicyFailed, Unauthorized, VlagentsError
from vlagents.observation import Observation
from vlagents.remote import RemotePolicy
from vlagents.service import Caller
from vlagents.wire.link import Deadline
from vlagents.wire.message import array_of
from vlagents.wire_server import Guest, WireServer

_log = logging.getLogger(__name__)

LARGEST = 32 << 20
"""Most bytes of a request or an answer."""
MOST_VALUES = 64 << 10
"""Most lists, dictionaries and commas in JSON; an image is one long string."""


class OpenvlaClient(RemotePolicy):
    """Calls a server of OpenVLA, at `openvla+http://host:port`, with one image, in a connection per call."""

    schemes = ("openvla+http",)

    def __init__(self, address: str, *, image: str = "", unnorm_key: str = "", **options: Any) -> None:
        """Set what the server does not say.

        Args:
            address: Where the server is.
            image: The camera whose image is sent; by default the only one.
            unnorm_key: The dataset whose statistics scale the actions; by default the server's.
            options: As of `RemotePolicy`.
        """
        self._image, self._unnorm_key = image, unnorm_key
        super().__init__(address, **options)

    def _connect(self) -> None:
        pass

    def _infer(self, observation: Observation) -> Chunk:
        if not self._image and len(observation.images) != 1:
            raise InvalidInput(f"OpenVLA sees one image; there are {sorted(observation.images)}. Give `image`.")
        picture = observation.image(self._image or next(iter(observation.images)))
        request: dict[str, Any] = {"image": to_map(picture), "instruction": self._instructed(observation).instruction}
        if self._unnorm_key:
            request["unnorm_key"] = self._unnorm_key
        answer = from_json(self._post(json.dumps(request).encode()))
        if isinstance(answer, str):
            raise PolicyFailed(f"{self.address} says that it failed; its log has the reason.")
        return self._chunk(answer, observation.time)

    def _post(self, data: bytes) -> bytes:
        deadline = Deadline(self.timeout, f"The answer of {self.address}")
        late = threading.Event()
        connection = http.client.HTTPConnection(self.address.host, self.address.port, timeout=self.timeout)
        headers = {"Content-Type": "application/json"}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"

        wire: list[socket.socket] = []  # the library forgets it before it reads the body of a last answer

        def end() -> None:  # a server that sends byte by byte is late at the deadline, too
            late.set()
            with contextlib.suppress(OSError):
                wire[0].shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(self.timeout, end)
        try:
            connection.connect()
            wire.append(connection.sock)
            timer.start()
            with contextlib.suppress(ConnectionError):  # one that refuses a token answers, and reads no further
                connection.request("POST", "/act", data, headers)
            answer = connection.getresponse()
            found = bytearray()
            while part := answer.read1(1 << 20):
                found += part
                if len(found) > LARGEST:
                    raise BadMessage(f"The answer of {self.address} is too large; valid are up to {LARGEST} bytes.")
            if late.is_set():
                raise deadline.exceeded()
        except (http.client.HTTPException, OSError) as error:
            if late.is_set() or isinstance(error, TimeoutError):
                raise deadline.exceeded() from error
            raise ConnectionLost(f"Nobody is at {self.address}: {error}.") from error
        finally:
            timer.cancel()
            connection.close()
        if answer.status == 401:
            raise Unauthorized("The token is missing or wrong.")
        if answer.status != 200:
            raise PolicyFailed(f"{self.address} answered with status {answer.status}.")
        return bytes(found)


class OpenvlaServer(WireServer):
    """Answers OpenVLA's clients with a policy. HTTP has no connection to distinguish robots: there is one session.

    The image of a request is the first one of the policy's metadata, or `image`.
    """

    schemes = ("openvla+http", None)

    _caller: Caller

    def _start_more(self) -> None:
        self._caller = Caller("openvla")

    def _open(self, guest: Guest) -> None:  # which answers the only request of a connection
        timer = threading.Timer(self._transfer, guest.connection.shutdown, (socket.SHUT_RD,))
        timer.start()  # for the whole request, even if it arrives byte by byte
        outside = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                outside._answer(self, guest)

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                _log.debug(format, *args)

        try:
            Handler(guest.connection, (guest.name, 0), self)  # type: ignore[arg-type]  which it does not look at
        except OSError as error:
            _log.debug("The connection of %s broke: %s", guest.name, error)
        finally:
            timer.cancel()

    def _answer(self, request: BaseHTTPRequestHandler, guest: Guest) -> None:
        status, answer = self._answered(request, guest)
        data = answer.encode()
        request.close_connection = True
        request.send_response(status)
        request.send_header("Content-Type", "application/json")
        request.send_header("Content-Length", str(len(data)))
        request.end_headers()
        request.wfile.write(data)

    def _answered(self, request: BaseHTTPRequestHandler, guest: Guest) -> tuple[int, str]:
        if "Origin" in request.headers:
            _log.warning("%s was refused: a page in a browser sent a request, and pages may not", guest.name)
            return 403, '"error"'
        kind, _, token = str(request.headers.get("Authorization", "")).partition(" ")
        try:
            self.service.admit(guest, token if kind == "Bearer" else "")
        except Unauthorized:
            return 401, '"error"'
        length = str(request.headers.get("Content-Length", ""))
        if request.path != "/act":
            return 404, '"error"'
        if not length.isdecimal() or int(length) > LARGEST:
            return 413, '"error"'
        try:
            given = from_json(request.rfile.read(int(length)))
            is_encoded = isinstance(given, Mapping) and isinstance(given.get("encoded"), str)
            answer = self._act(from_json(given["encoded"].encode()) if is_encoded else given)
        except Exception as error:  # noqa: BLE001  as OpenVLA does: the client learns that it failed, not why
            known = isinstance(error, VlagentsError)
            _log.warning("A request of %s failed: %s", guest.name, error, exc_info=not known)
            return 200, '"error"'
        text = json.dumps(to_map(answer))
        return 200, json.dumps(text) if is_encoded else text

    def _act(self, given: object) -> NDArray[Any]:
        if not isinstance(given, Mapping) or not isinstance(given.get("instruction"), str):
            raise InvalidInput("A request has no instruction.")
        images = self.service.metadata.images
        name = images[0].name if images else "image"
        observation = Observation({name: given.get("image")}, {}, given["instruction"])  # type: ignore[dict-item]
        actions = np.asarray(self.service.infer(self._caller, observation)["actions"])
        return actions[0] if len(actions) == 1 else actions


def to_map(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array as json-numpy writes it."""
    data = base64.b64encode(array.tobytes()).decode()
    return {"__numpy__": data, "dtype": array.dtype.str, "shape": list(array.shape)}


def from_json(data: bytes) -> Any:
    """Read JSON with json-numpy's arrays.

    Raises:
        BadMessage: It is no JSON, or has more than `MOST_VALUES` values.
    """
    # Two bytes of a list in JSON are 56 of memory, and other threads wait for Python's lock while JSON is read.
    if sum(data.count(mark) for mark in b"[{,") > MOST_VALUES:
        raise BadMessage(f"JSON has more than {MOST_VALUES} values; an array is the base64 of its bytes.")
    try:
        return json.loads(data, object_hook=_from_map)
    except BadMessage:
        raise
    except (ValueError, RecursionError) as error:
        raise BadMessage(f"This is no JSON: {error}.") from error


def _from_map(found: dict[str, Any]) -> Any:
    if "__numpy__" not in found:
        return found
    try:
        data = base64.b64decode(found["__numpy__"], validate=True)
    except (binascii.Error, TypeError, ValueError) as error:
        raise BadMessage(f"An array is no base64: {error}.") from error
    return array_of(data, found.get("dtype"), found.get("shape"))
