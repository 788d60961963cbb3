"""openpi's websocket, both ways: its clients call our policies, and our client calls its servers.

On connecting, the server sends its metadata. Then every observation is answered with actions; an error is a message of
text, after which the server ends the connection. Between two sides of ours, the key `vlagents` carries what openpi does
not have: sessions, resets, and errors that do not end the connection.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from typing import Any

from vlagents.chunk import Chunk
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    PolicyFailed,
    Unauthorized,
    VlagentsError,
    from_failure,
)
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.remote import RemotePolicy
from vlagents.service import Caller
from vlagents.wire.calls import chunk_from_values
from vlagents.wire.frames import FrameChannel
from vlagents.wire.handshake import accept, ask
from vlagents.wire.link import Deadline, Link, dial
from vlagents.wire.openpi import ACTIONS, OWN, observation_from_flat, observation_to_flat, pack_parts, unpack
from vlagents.wire_server import BEGIN, Guest, WireServer

ATTENDED = 2.0
"""Period of answering the other side's pings between calls, or while the policy works [s]; openpi waits 20 s."""


class WebsocketClient(RemotePolicy):
    """Calls a server over openpi's websocket: one of openpi's, which remembers nothing, or ours."""

    schemes = ("ws", "wss")
    _channel: FrameChannel | None
    _is_ours = False

    def __init__(self, address: str, **options: Any) -> None:
        """Connect, as `RemotePolicy` does; the token is sent as `Authorization: Api-Key TOKEN`."""
        self._number = 0
        self._is_closed = threading.Event()
        super().__init__(address, **options)
        threading.Thread(target=self._attend, name=f"vlagents pongs to {self.address}", daemon=True).start()

    def close(self) -> None:
        """End the connection."""
        self._is_closed.set()
        super().close()

    def _infer(self, observation: Observation) -> Chunk:
        if self._is_ours:
            own = {"session": observation.session, "time": float(observation.time)}
            answer = self._ask({**observation_to_flat(observation), OWN: own}).get(OWN)
            return chunk_from_values(answer.get("chunk") if isinstance(answer, Mapping) else None)
        answer = self._ask(observation_to_flat(self._instructed(observation)))
        timing = answer.get("server_timing")
        times = timing.items() if isinstance(timing, Mapping) else ()
        info = {name: float(value) for name, value in times if isinstance(value, (int, float))}
        return self._chunk(answer.get(ACTIONS), observation.time, info)

    def _attend(self) -> None:
        while not self._is_closed.wait(ATTENDED):
            channel = self._channel
            if channel is not None:
                channel.attend()

    def _tell(self, call: str, **given: Any) -> None:
        if self._is_ours:
            self._number += 1
            self._ask({OWN: {"call": call, "id": self._number, "within": self.timeout, **given}})

    def _ask(self, values: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            channel = self._connected()
            parts = pack_parts(values)
            deadline = Deadline(self.timeout, f"The answer of {self.address}")
            try:
                channel.send(parts, deadline)
                answer = self._received(channel, deadline)
            except VlagentsError:
                self._lose(channel)
                raise
        own = answer.get(OWN)
        if isinstance(own, Mapping) and "error" in own:
            raise from_failure(own["error"])
        return answer

    def _received(self, channel: FrameChannel, deadline: Deadline) -> dict[str, Any]:
        message = channel.receive(deadline)
        if isinstance(message, str):  # openpi's way to say what went wrong; it closes then
            raise PolicyFailed(f"{self.address} failed: {message[:4000]}")
        answer = unpack(message)
        if not isinstance(answer, dict):
            raise BadMessage(f"{self.address} sent {type(answer).__name__}; valid is a dictionary.")
        return answer

    def _connect(self) -> None:
        deadline = Deadline(self.timeout, f"The greeting of {self.address}")
        headers = {} if self._token is None else {"Authorization": f"Api-Key {self._token}"}
        link = Link(dial(self.address, self.timeout, self._certificate))
        channel = FrameChannel(link, is_client=True)
        with channel.guarded():
            ask(link, str(self.address), headers, deadline)
            greeting = self._received(channel, deadline)
            self._is_ours = isinstance(greeting.get(OWN), Mapping)
            if self._is_ours:
                self._metadata = Metadata.from_dict(greeting[OWN])
        self._channel = channel


class WebsocketServer(WireServer):
    """Answers openpi's clients, and ours, over a websocket. `GET /healthz` returns OK."""

    schemes = ("ws", "wss")
    _health = ("/healthz", "OK\n")
    """Path of a request for health, and the answer."""

    def _start_more(self) -> None:
        self._run("vlagents pongs", self._attend)

    def _attend(self) -> None:
        while not self._is_closing.wait(ATTENDED):
            for channel in self.channels:
                channel.attend()

    def _admit(self, guest: Guest, request: Any) -> tuple[int, str] | None:
        """Return an answer other than a websocket: health, or a refusal of a wrong token."""
        if request.path == self._health[0]:
            return 200, self._health[1]
        kind, _, token = (request.headers.get_all("Authorization") or [""])[-1].partition(" ")
        try:
            self.service.admit(guest, token if kind in ("Api-Key", "Bearer") else "")
        except Unauthorized as error:
            return 401, f"{error}\n"
        return None

    def _open(self, guest: Guest) -> FrameChannel | None:
        link = Link(guest.connection)
        if not accept(link, Deadline(BEGIN, "a request"), lambda request: self._admit(guest, request)):
            return None
        channel = FrameChannel(link, is_client=False, largest=self._largest)
        self._greet(guest, channel)
        return channel

    def _greet(self, guest: Guest, channel: FrameChannel) -> None:
        metadata = self.service.metadata
        channel.send(pack_parts({"policy": metadata.name, OWN: metadata.to_dict()}), self._rest())

    def _answer_one(self, guest: Guest, channel: FrameChannel) -> None:
        try:
            message = channel.receive(Deadline(None, ""), self._rest())
            channel.send(pack_parts(self._answer(guest, message)), self._rest())
        except ConnectionLost:
            raise
        except VlagentsError as error:  # sent as text before the end, as openpi's servers do
            with contextlib.suppress(VlagentsError):
                channel.send(f"{type(error).__name__}: {error}", Deadline(1.0, "reading of an error"))
                channel.close(1011, type(error).__name__, linger=1.0)
            raise

    def _answer(self, caller: Caller, message: str | memoryview) -> dict[str, Any]:
        values = None if isinstance(message, str) else unpack(message)
        if not isinstance(values, Mapping):
            kind = "text" if isinstance(message, str) else type(values).__name__
            raise BadMessage(f"A message is {kind}; valid is a dictionary in msgpack.")
        own = values.get(OWN)
        if own is not None and not isinstance(own, Mapping):
            raise BadMessage(f"{OWN!r} is {type(own).__name__}; valid is a dictionary.")
        try:
            if own is not None and "call" in own:
                return {OWN: self.service.answer(caller, own)}
            return self._act(caller, values, own or {})
        except BadMessage:
            raise
        except Exception as error:
            failure = self.service.failure(caller, error)
            if own is None:  # a client of openpi's, whose connection ends
                raise from_failure(failure) from error
            return {OWN: {"error": failure}}

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
