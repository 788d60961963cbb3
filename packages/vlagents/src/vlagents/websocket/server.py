"""Answers openpi's clients over a websocket.

On connecting, the server sends its metadata. Then every observation is answered with actions; an error is a message of
text, after which the server ends the connection. Between two sides of ours, the key `vlagents` carries what openpi does
not have: sessions, resets, the offer, and errors that end nothing.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from vlagents.address import Address
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    Unauthorized,
    VlagentsError,
    as_failure,
    from_failure,
)
from vlagents.listening import BEGIN, TRANSFER, Acceptor, Guest, Listening
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire.deadline import Deadline
from vlagents.wire.frames import FrameChannel
from vlagents.wire.handshake import accept
from vlagents.wire.link import Link
from vlagents.wire.openpi import ACTIONS, OWN, observation_from_flat, pack_parts, unpack
from vlagents.wire.stream import LARGEST_BODY

_log = logging.getLogger(__name__)

ATTENDED = 2.0
"""How often pings of clients are looked for that wait for the policy [s]; theirs wait 20 s."""


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
        transfer: float = TRANSFER,
    ) -> None:
        """Prepare; `start` or a `with` block opens the socket.

        Args:
            policy: It is closed with the server.
            host: As in `Listening`.
            port: As in `Listening`.
            token: As in `Listening`; clients send it as `Authorization: Api-Key TOKEN`.
            certificate: As in `Listening`.
            key: As in `Listening`.
            largest: Most bytes of a message.
            transfer: How long a message may take to come once it began, and an answer to be read [s].

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is half given.
        """
        self._listening = Listening(host=host, port=port, token=token, certificate=certificate, key=key)
        self._tls = self._listening.tls()
        self.service = Service(policy, token=token)
        self._largest, self._transfer = largest, transfer
        self._acceptor = Acceptor()
        self._port = port

    @property
    def address(self) -> Address:
        """Where the server listens."""
        return Address("ws" if self._tls is None else "wss", host=self._listening.host, port=self._port)

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._acceptor.open)

    def start(self) -> WebsocketServer:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port cannot be had.
        """
        listener = self._listening.open()
        self._port = listener.getsockname()[1]
        self._acceptor.listen(listener, self._converse)
        self._acceptor.run("vlagents pongs", self._attend)
        return self

    def serve_forever(self) -> None:
        """Wait until `close` is called, from another thread or a signal's handler."""
        self._acceptor.is_closing.wait()

    def close(self) -> None:
        """End all connections, then close the policy, as `Service.close` does. A second call does nothing."""
        self._acceptor.close()
        self.service.close()

    def __enter__(self) -> WebsocketServer:
        """Start."""
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _attend(self) -> None:
        while not self._acceptor.is_closing.wait(ATTENDED):
            for conversation in self._acceptor.open:
                if isinstance(conversation, FrameChannel):
                    conversation.attend()

    def _admit(self, name: str, request: Any) -> tuple[int, str] | None:
        """Answer a request for health, and let in who knows the token."""
        if request.path == "/healthz":
            return 200, "OK\n"
        kind, _, token = (request.headers.get_all("Authorization") or [""])[-1].partition(" ")
        try:
            self.service.admit(Caller(name, -1), token if kind in ("Api-Key", "Bearer") else "")
        except Unauthorized as error:
            return 401, f"{error}\n"
        return None

    def _converse(self, guest: Guest) -> None:
        try:
            if self._tls is not None:
                guest.secure(self._tls)
            link = Link(guest.connection)
            is_websocket = accept(link, Deadline(BEGIN, "a request"), lambda request: self._admit(guest.name, request))
        except (OSError, ValueError, VlagentsError) as error:
            _log.warning("%s was refused: %s", guest.name, error)
            return
        if is_websocket:
            guest.is_known = True
            self._answer_all(FrameChannel(link, is_client=False, largest=self._largest), guest.name)

    def _answer_all(self, channel: FrameChannel, name: str) -> None:
        caller = self.service.caller(name)
        caller.is_known = True  # `_admit` has let it in
        metadata = self.service.metadata
        self._acceptor.enter(channel)
        try:
            self._send(channel, {"policy": metadata.name, OWN: metadata.to_dict()})
            while True:
                self._send(channel, self._answer(caller, self._receive(channel)))
        except ConnectionLost:
            pass
        except VlagentsError as error:
            if not self._acceptor.is_closing.is_set():
                _log.warning("The connection of %s was ended: %s", name, error)
            with contextlib.suppress(VlagentsError):
                channel.send(f"{type(error).__name__}: {error}", Deadline(1.0, "reading of an error"))
                channel.close(1011, type(error).__name__, linger=1.0)
        finally:
            self._acceptor.leave(channel)
            channel.close()
            self.service.forget(caller)

    def _receive(self, channel: FrameChannel) -> str | memoryview:
        return channel.receive(Deadline(None, ""), Deadline(self._transfer, "the rest of a message"))

    def _send(self, channel: FrameChannel, values: Mapping[str, Any]) -> None:
        channel.send(pack_parts(values), Deadline(self._transfer, "reading of an answer"))

    def _answer(self, caller: Caller, message: str | memoryview) -> dict[str, Any]:
        if isinstance(message, str):
            raise BadMessage("A message is text; valid is msgpack.")
        values = unpack(message)
        if not isinstance(values, Mapping):
            raise BadMessage(f"A message is {type(values).__name__}; valid is a dictionary.")
        own = values.get(OWN)
        if own is None:
            return self._act_or_end(caller, values)
        if not isinstance(own, Mapping):
            raise BadMessage(f"{OWN!r} is {type(own).__name__}; valid is a dictionary.")
        try:
            if "call" in own:
                return {OWN: self.service.answer(caller, own)}
            return self._act(caller, values, own)
        except BadMessage:
            raise
        except Exception as error:  # noqa: BLE001  our client reads errors without losing its connection
            return {OWN: {"error": as_failure(error)}}

    def _act_or_end(self, caller: Caller, values: Mapping[str, Any]) -> dict[str, Any]:
        """Answer a client of openpi's, who learns what goes wrong by the end of its connection."""
        try:
            return self._act(caller, values, {})
        except VlagentsError:
            raise
        except Exception as error:
            _log.exception("The policy failed to answer %s", caller.name)
            raise from_failure(as_failure(error)) from error

    def _act(self, caller: Caller, values: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
        session, moment = str(own.get("session", "")), own.get("time", 0.0)
        if isinstance(moment, bool) or not isinstance(moment, (int, float)):
            raise InvalidInput(f"time is {moment!r:.80}; valid is a number.")
        observation = observation_from_flat(values, session=session, time=float(moment))
        begin = time.perf_counter()
        chunk = self.service.infer(caller, observation)
        answer: dict[str, Any] = {ACTIONS: chunk["actions"]}
        answer["server_timing"] = {"infer_ms": 1e3 * (time.perf_counter() - begin)}
        if own:
            answer[OWN] = {"chunk": chunk}
        return answer
