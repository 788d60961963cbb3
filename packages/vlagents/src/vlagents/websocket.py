"""openpi's websocket, both ways: its clients ask our policies, and our client asks its servers.

On connecting, the server sends its metadata. Then every observation is answered with actions; an error is a message of
text, after which the server ends the connection. Between two sides of ours, the key `vlagents` carries what openpi does
not have: sessions, resets, the offer, and errors that end nothing.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
import time
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidHandshake, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.sync.server import ServerConnection, serve

from vlagents.address import Address, is_loopback, parse
from vlagents.chunk import Chunk
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    DeadlineExceeded,
    InvalidInput,
    Mismatch,
    Unauthorized,
    VlagentsError,
    as_failure,
    from_failure,
)
from vlagents.metadata import Metadata, Offer, differences
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire.calls import chunk_from_values
from vlagents.wire.openpi import ACTIONS, OWN, chunk_from_flat, observation_from_flat, observation_to_flat, pack, unpack
from vlagents.wire.stream import LARGEST_BODY

TRANSFER = 10.0
"""How long a greeting, an opening or a closing handshake may take [s]."""


class WebsocketServer:
    """Answers openpi's clients, and ours, over a websocket. `GET /healthz` says OK."""

    def __init__(
        self,
        policy: Policy,
        *,
        host: str = "127.0.0.1",
        port: int = 8000,
        token: str | None = None,
        certificate: str | Path | None = None,
        key: str | Path | None = None,
        largest: int = LARGEST_BODY,
    ) -> None:
        """Prepare; `start` or a `with` block opens the socket.

        Args:
            policy: It is closed with the server.
            host: Where to listen. Anything but this machine itself needs a token.
            port: Of TCP; 0 for any that is free.
            token: What clients must send as `Authorization: Api-Key TOKEN`; None for nothing.
            certificate: File with a certificate, for TLS.
            key: File with its key.
            largest: Most bytes of a message.

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is half given.
        """
        if not is_loopback(host) and token is None:
            raise InvalidInput(
                f"The host {host!r} can be reached from other machines, and there is no token: anybody could ask the "
                "policy. Give a token, or listen at 127.0.0.1."
            )
        if (certificate is None) != (key is None):
            raise InvalidInput("TLS needs both, certificate and key.")
        self.service = Service(policy, token=token)
        tls: ssl.SSLContext | None = None
        if certificate is not None:
            tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            tls.load_cert_chain(certificate, key)
        self._options: dict[str, Any] = {
            "host": host,
            "port": port,
            "ssl": tls,
            "compression": None,
            "max_size": largest,
            "open_timeout": TRANSFER,
            "close_timeout": 1.0,
            "process_request": self._admit,
        }
        self._server: Any = None
        self._open: set[ServerConnection] = set()
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> Address:
        """Where the server listens."""
        port = self._options["port"] if self._server is None else self._server.socket.getsockname()[1]
        return Address("ws" if self._options["ssl"] is None else "wss", host=self._options["host"], port=port)

    def start(self) -> WebsocketServer:
        """Listen, and answer in threads of its own.

        Raises:
            OSError: The port is taken.
        """
        self._server = serve(self._converse, **self._options)
        self._thread = threading.Thread(target=self._server.serve_forever, name="vlagents websocket", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """End all connections, then the policy. A second call does nothing."""
        if self._server is not None:
            self._server.shutdown()
            self._server = None
        for connection in list(self._open):  # older versions of the library leave them open
            with contextlib.suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)
        self.service.close()

    def __enter__(self) -> WebsocketServer:
        """Start."""
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _admit(self, connection: ServerConnection, request: Any) -> Any:
        """Answer a request for health, and let in who knows the token."""
        if request.path == "/healthz":
            return connection.respond(HTTPStatus.OK, "OK\n")
        kind, _, token = str(request.headers.get("Authorization", "")).partition(" ")
        try:
            self.service.admit(
                Caller(str(connection.remote_address), -1), token if kind in ("Api-Key", "Bearer") else ""
            )
        except Unauthorized as error:
            return connection.respond(HTTPStatus.UNAUTHORIZED, f"{error}\n")
        return None

    def _converse(self, connection: ServerConnection) -> None:
        caller = self.service.caller(str(connection.remote_address))
        caller.is_known = True  # `_admit` has let it in
        metadata = self.service.metadata
        self._open.add(connection)
        try:
            connection.send(pack({"policy": metadata.name, OWN: metadata.to_dict()}))
            for message in connection:
                connection.send(self._answer(caller, message))
        except VlagentsError as error:
            with contextlib.suppress(ConnectionClosed):
                connection.send(f"{type(error).__name__}: {error}")
        except ConnectionClosed:
            pass
        finally:
            self._open.discard(connection)
            self.service.forget(caller)

    def _answer(self, caller: Caller, message: str | bytes) -> bytes:
        if isinstance(message, str):
            raise BadMessage("A message is text; valid is msgpack.")
        values = unpack(message)
        if not isinstance(values, Mapping):
            raise BadMessage(f"A message is {type(values).__name__}; valid is a dictionary.")
        own = values.get(OWN)
        if own is None:
            return self._act(caller, values, {})
        if not isinstance(own, Mapping):
            raise BadMessage(f"{OWN!r} is {type(own).__name__}; valid is a dictionary.")
        try:
            if "call" in own:
                return pack({OWN: self.service.answer(caller, own)})
            return self._act(caller, values, own)
        except BadMessage:
            raise
        except Exception as error:  # noqa: BLE001  our client reads errors without losing its connection
            return pack({OWN: {"error": as_failure(error)}})

    def _act(self, caller: Caller, values: Mapping[str, Any], own: Mapping[str, Any]) -> bytes:
        session, moment = str(own.get("session", "")), own.get("time", 0.0)
        if isinstance(moment, bool) or not isinstance(moment, (int, float)):
            raise InvalidInput(f"time is {moment!r:.80}; valid is a number.")
        observation = observation_from_flat(values, session=session, time=float(moment))
        begin = time.perf_counter()
        chunk = self.service.infer(caller, observation)
        answer: dict[str, Any] = {ACTIONS: chunk["actions"]}
        answer["server_timing"] = {"infer_ms": 1e3 * (time.perf_counter() - begin)}
        if own:
            answer[OWN] = {"chunk": {**chunk, ACTIONS: chunk["actions"]}}
        return pack(answer)


class WebsocketClient(Policy):
    """Asks a server over openpi's websocket: one of openpi's, or ours."""

    def __init__(
        self,
        address: str,
        *,
        token: str | None = None,
        timeout: float = 5.0,
        offer: Offer | None = None,
        metadata: Metadata | None = None,
        period: float | None = None,
        certificate: str | Path | None = None,
    ) -> None:
        """Connect, and compare what the robot offers with what the policy needs.

        Args:
            address: `ws://host:port` or `wss://host:port`.
            token: Sent as `Authorization: Api-Key TOKEN`.
            timeout: How long an answer may take [s].
            offer: What the robot shows and takes; None to compare nothing.
            metadata: What the policy needs and gives, where the server does not tell: openpi's do not.
            period: Time that each row of a chunk is for [s], where the metadata have no rate.
            certificate: File with the certificate that the server's must be signed by; None for those of the system.

        Raises:
            InvalidInput: The address is none.
            ConnectionLost: Nobody is there.
            DeadlineExceeded: Somebody is, and says nothing.
            Unauthorized: The token is wrong.
            Mismatch: Robot and policy do not fit.
        """
        self.address = parse(address)
        if self.address.scheme not in ("ws", "wss"):
            raise InvalidInput(f"{address!r} is no websocket; use vlagents.client.Client.")
        self.timeout = float(timeout)
        """How long an answer may take [s]."""
        self._token, self._offer, self._told, self._period = token, offer, metadata, period
        self._tls: ssl.SSLContext | None = None
        if self.address.scheme == "wss":
            self._tls = ssl.create_default_context(cafile=None if certificate is None else str(certificate))
        self._lock = threading.Lock()
        self._number = 0
        self._connection: ClientConnection | None = None
        self._opened = contextlib.ExitStack()
        self._is_ours = False
        self._metadata = self._connect()

    def metadata(self) -> Metadata:
        """Return what the server told, or what was given in its place."""
        return self._metadata

    def infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation.

        Raises:
            ConnectionLost: The server has gone.
            DeadlineExceeded: It did not answer in time; the connection is closed, for openpi's answers have no number.
            InvalidInput: The observation is not what the policy takes.
            PolicyFailed: The policy raised an error.
        """
        values = observation_to_flat(observation)
        if self._is_ours:
            values[OWN] = {"session": observation.session, "time": float(observation.time)}
        answer = self._ask(values)
        own = answer.get(OWN)
        if isinstance(own, Mapping) and "chunk" in own:
            return chunk_from_values(own["chunk"])
        rate = self._metadata.rate
        period = self._period if self._period is not None else 1.0 / rate if rate > 0 else None
        if period is None:
            raise InvalidInput(f"{self.address} does not tell what time an action is for; give `period`.")
        return chunk_from_flat(answer, period, observation.time)

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode; connect anew if the server was gone. openpi's servers remember nothing."""
        with self._lock:
            if self._connection is None:
                self._metadata = self._connect()
        if self._is_ours:
            self._call("reset", session=session, instruction=instruction, seed=seed)

    def forget(self, session: str) -> None:
        """Let a server of ours forget a session."""
        if self._is_ours:
            self._call("forget", session=session)

    def close(self) -> None:
        """End the connection."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._opened.close()

    def _call(self, call: str, **given: Any) -> None:
        self._number += 1
        self._ask({OWN: {"call": call, "id": self._number, "within": self.timeout, **given}})

    def _ask(self, values: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            connection = self._connection
            if connection is None:
                raise ConnectionLost(f"There is no connection to {self.address}; `reset` connects anew.")
            data = pack(values)
            try:
                connection.send(data)
                message = connection.recv(timeout=self.timeout)
            except TimeoutError as error:
                self._lose(connection)
                raise DeadlineExceeded(f"{self.address} did not answer within {self.timeout:g} s.") from error
            except (WebSocketException, OSError) as error:
                self._lose(connection)
                raise ConnectionLost(f"The connection to {self.address} broke: {error}.") from error
            try:
                return self._read(message)
            except BadMessage:
                self._lose(connection)
                raise

    def _read(self, message: str | bytes) -> dict[str, Any]:
        if isinstance(message, str):  # openpi's way to say what went wrong; it closes then
            raise BadMessage(f"{self.address} failed: {message[:4000]}")
        answer = unpack(message)
        if not isinstance(answer, dict):
            raise BadMessage(f"{self.address} sent {type(answer).__name__}; valid is a dictionary.")
        own = answer.get(OWN)
        if isinstance(own, Mapping) and "error" in own:
            raise from_failure(own["error"])
        return answer

    def _lose(self, connection: ClientConnection) -> None:
        if self._connection is connection:
            self._connection = None
        with contextlib.suppress(Exception):
            connection.socket.close()

    def _connect(self) -> Metadata:
        headers = {} if self._token is None else {"Authorization": f"Api-Key {self._token}"}
        try:
            opened = contextlib.ExitStack()
            connection: Any = opened.enter_context(
                connect(
                    str(self.address),
                    additional_headers=headers,
                    ssl=self._tls,
                    compression=None,
                    max_size=LARGEST_BODY,
                    open_timeout=self.timeout,
                    close_timeout=1.0,
                    proxy=None,
                )
            )
        except TimeoutError as error:
            raise DeadlineExceeded(f"{self.address} did not answer within {self.timeout:g} s.") from error
        except InvalidHandshake as error:
            if "401" in str(error):
                raise Unauthorized("The token is missing or wrong.") from error
            raise ConnectionLost(f"{self.address} is no websocket: {error}.") from error
        except (OSError, WebSocketException) as error:
            raise ConnectionLost(f"Nobody is at {self.address}: {error}.") from error
        self._connection, self._opened = connection, opened
        try:
            return self._greeted(self._read(connection.recv(timeout=self.timeout)))
        except TimeoutError as error:
            self._lose(connection)
            raise DeadlineExceeded(f"{self.address} did not tell its metadata within {self.timeout:g} s.") from error
        except WebSocketException as error:
            self._lose(connection)
            raise ConnectionLost(f"The connection to {self.address} broke: {error}.") from error
        except VlagentsError:
            self._lose(connection)
            raise

    def _greeted(self, greeting: dict[str, Any]) -> Metadata:
        self._is_ours = isinstance(greeting.get(OWN), Mapping)
        if self._is_ours:
            metadata = Metadata.from_dict(greeting[OWN])
        elif self._told is not None:
            metadata = self._told
        else:
            metadata = Metadata(name="openpi", action=(), extra=greeting)
        if self._offer is not None and metadata.action and (found := differences(metadata, self._offer)):
            raise Mismatch(found)
        return metadata
