"""Calls a server over openpi's websocket: one of openpi's, or ours."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vlagents.address import parse
from vlagents.chunk import Chunk
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    Mismatch,
    VlagentsError,
    from_failure,
)
from vlagents.metadata import Metadata, Offer, differences
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.record import positive
from vlagents.wire.calls import chunk_from_values
from vlagents.wire.frames import FrameChannel
from vlagents.wire.handshake import ask
from vlagents.wire.link import Deadline, Link, dial
from vlagents.wire.openpi import OWN, chunk_from_flat, observation_to_flat, pack_parts, unpack
from vlagents.wire.stream import LARGEST_BODY

ATTENDED = 2.0
"""Period of answering pings of the server between calls [s]; openpi's servers wait 20 s."""


class WebsocketClient(Policy):
    """Calls a server over openpi's websocket: one of openpi's, or ours."""

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
            metadata: What the policy needs and gives, where the server does not say: openpi's do not.
            period: Time that each row of a chunk is for [s], where the metadata have no rate.
            certificate: File with the certificate that the server's must be signed by; None for those of the system.

        Raises:
            InvalidInput: The address is not valid.
            ConnectionLost: No server is there.
            DeadlineExceeded: It does not answer.
            Unauthorized: The token is wrong.
            Mismatch: Robot and policy do not fit.
        """
        self.address = parse(address)
        if self.address.scheme not in ("ws", "wss"):
            raise InvalidInput(f"{address!r} is no websocket; use vlagents.connect.")
        self.timeout = positive("timeout", timeout)
        """How long an answer may take [s]."""
        self._token, self._offer, self._given, self._period = token, offer, metadata, period
        self._certificate = certificate
        self._lock = threading.RLock()
        self._number = 0
        self._channel: FrameChannel | None = None
        self._is_ours = False
        self._metadata = self._connect()
        self._is_closed = threading.Event()
        threading.Thread(target=self._attend, name=f"vlagents pongs to {self.address}", daemon=True).start()

    def metadata(self) -> Metadata:
        """Return the server's metadata, or those that stand in for them."""
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
        with self._lock:  # until the chunk is copied out of the answer's memory
            answer = self._ask(values)
            own = answer.get(OWN)
            if isinstance(own, Mapping) and "chunk" in own:
                return chunk_from_values(own["chunk"])
            rate = self._metadata.rate
            period = self._period if self._period is not None else 1.0 / rate if rate > 0 else None
            if period is None:
                raise InvalidInput(f"{self.address} does not say what time an action is for; give `period`.")
            return chunk_from_flat(answer, period, observation.time)

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode; connect again if the server was gone. openpi's servers remember nothing."""
        with self._lock:
            if self._channel is None:
                self._metadata = self._connect()
        if self._is_ours:
            self._call("reset", session=session, instruction=instruction, seed=seed)

    def forget(self, session: str) -> None:
        """Have a server of ours forget a session."""
        if self._is_ours:
            self._call("forget", session=session)

    def close(self) -> None:
        """End the connection."""
        self._is_closed.set()
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _attend(self) -> None:
        while not self._is_closed.wait(ATTENDED):
            channel = self._channel
            if channel is not None:
                channel.attend()

    def _call(self, call: str, **given: Any) -> None:
        self._number += 1
        self._ask({OWN: {"call": call, "id": self._number, "within": self.timeout, **given}})

    def _ask(self, values: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            channel = self._channel
            if channel is None:
                raise ConnectionLost(f"There is no connection to {self.address}; `reset` connects again.")
            parts = pack_parts(values)
            deadline = Deadline(self.timeout, f"The answer of {self.address}")
            try:
                channel.send(parts, deadline)
                message = channel.receive(deadline)
            except VlagentsError:
                self._lose(channel)
                raise
            try:
                return self._read(message)
            except BadMessage:
                self._lose(channel)
                raise

    def _read(self, message: str | memoryview) -> dict[str, Any]:
        if isinstance(message, str):  # openpi's way to say what went wrong; it closes then
            raise BadMessage(f"{self.address} failed: {message[:4000]}")
        answer = unpack(message)
        if not isinstance(answer, dict):
            raise BadMessage(f"{self.address} sent {type(answer).__name__}; valid is a dictionary.")
        own = answer.get(OWN)
        if isinstance(own, Mapping) and "error" in own:
            raise from_failure(own["error"])
        return answer

    def _lose(self, channel: FrameChannel) -> None:
        channel.close()
        if self._channel is channel:
            self._channel = None

    def _connect(self) -> Metadata:
        deadline = Deadline(self.timeout, f"The greeting of {self.address}")
        headers = {} if self._token is None else {"Authorization": f"Api-Key {self._token}"}
        link = Link(dial(self.address, self.timeout, self._certificate))
        try:
            ask(link, str(self.address), headers, deadline)
            channel = FrameChannel(link, is_client=True, largest=LARGEST_BODY)
            metadata = self._greeted(self._read(channel.receive(deadline)))
        except OSError as error:
            link.close()
            if isinstance(error, VlagentsError):
                raise
            raise ConnectionLost(f"The connection to {self.address} broke: {error}.") from error
        except BaseException:
            link.close()
            raise
        self._channel = channel
        return metadata

    def _greeted(self, greeting: dict[str, Any]) -> Metadata:
        self._is_ours = isinstance(greeting.get(OWN), Mapping)
        if self._is_ours:
            metadata = Metadata.from_dict(greeting[OWN])
        else:
            metadata = self._given or Metadata(name="openpi", action=())
        if self._offer is not None and metadata.action and (found := differences(metadata, self._offer)):
            raise Mismatch(found)
        return metadata
