"""Answers openpi's clients over a websocket.

On connecting, the server sends its metadata. Then every observation is answered with actions; an error is a message of
text, after which the server ends the connection. Between two sides of ours, the key `vlagents` carries what openpi does
not have: sessions, resets, the offer, and errors that do not end the connection.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Generator, Mapping
from typing import Any

from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    Unauthorized,
    VlagentsError,
    as_failure,
    from_failure,
)
from vlagents.policy import Policy
from vlagents.service import Caller
from vlagents.wire.frames import FrameChannel
from vlagents.wire.handshake import accept
from vlagents.wire.link import Deadline, Link
from vlagents.wire.openpi import ACTIONS, OWN, observation_from_flat, pack_parts, unpack
from vlagents.wire.stream import LARGEST_BODY
from vlagents.wire_server import BEGIN, Guest, WireServer

_log = logging.getLogger(__name__)

ATTENDED = 2.0
"""Period of answering pings of clients that wait for the policy [s]; theirs wait 20 s."""


class WebsocketServer(WireServer):
    """Answers openpi's clients, and ours, over a websocket. `GET /healthz` returns OK."""

    schemes = ("ws", "wss")

    def __init__(self, policy: Policy, *, port: int = 8000, largest: int = LARGEST_BODY, **options: Any) -> None:
        """Prepare; `start` or a `with` block opens the socket.

        Args:
            policy: The policy to serve; it is closed with the server.
            port: TCP port; 0 for any that is free.
            largest: Most bytes of a message.
            options: `host`, `token` (which clients send as `Authorization: Api-Key TOKEN`), `certificate`, `key` and
                `transfer`, as of `WireServer`.

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is incomplete.
        """
        super().__init__(policy, port=port, **options)
        self._largest = largest

    def start(self) -> WebsocketServer:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port is not available.
        """
        super().start()
        self._run("vlagents pongs", self._attend)
        return self

    def _attend(self) -> None:
        while not self._is_closing.wait(ATTENDED):
            for channel in self.channels:
                channel.attend()

    def _admit(self, name: str, request: Any) -> tuple[int, str] | None:
        """Return an answer other than a websocket: health, or a refusal of a wrong token."""
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
            guest.secure(self._tls)
            link = Link(guest.connection)
            is_websocket = accept(link, Deadline(BEGIN, "a request"), lambda request: self._admit(guest.name, request))
        except (OSError, ValueError, VlagentsError) as error:
            _log.warning("%s was refused: %s", guest.name, error)
            return
        if is_websocket:
            guest.is_known = True
            self._answer_all(guest, FrameChannel(link, is_client=False, largest=self._largest))

    def _answer_all(self, guest: Guest, channel: FrameChannel) -> None:
        caller = self.service.caller(guest.name)
        caller.is_known = True  # `_admit` has checked its token
        metadata = self.service.metadata
        try:
            with self._conversation(guest, channel), _errors_are_sent(channel):
                self._send(channel, {"policy": metadata.name, OWN: metadata.to_dict()})
                while True:
                    self._send(channel, self._answer(caller, self._receive(channel)))
        finally:
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
        except Exception as error:  # noqa: BLE001  our client reads errors and keeps its connection
            return {OWN: {"error": as_failure(error)}}

    def _act_or_end(self, caller: Caller, values: Mapping[str, Any]) -> dict[str, Any]:
        """Answer a client of openpi's; an error ends its connection."""
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


@contextlib.contextmanager
def _errors_are_sent(channel: FrameChannel) -> Generator[None]:
    """Send the error that ends a conversation as text, as openpi's servers do."""
    try:
        yield
    except ConnectionLost:
        raise
    except VlagentsError as error:
        with contextlib.suppress(VlagentsError):
            channel.send(f"{type(error).__name__}: {error}", Deadline(1.0, "reading of an error"))
            channel.close(1011, type(error).__name__, linger=1.0)
        raise
