"""GR00T's wire, both ways: ZeroMQ requests and replies of msgpack, with arrays as the bytes of `.npy` files.

Layout as in Isaac-GR00T's `gr00t/policy/server_client.py`: `{"endpoint", "data", "api_token"}` goes there. Of
`get_action`, the data are `{"observation": {"video": {camera: uint8 [B, T, H, W, 3]}, "state": {part: float32
[B, T, D]}, "language": {"task": [[str]]}}, "options"}`, and `[{part: float32 [B, T, D]}, info]` comes back; an error is
`{"error": str}`. Files of pickled objects are refused, and the endpoint `kill` does not exist here.
"""

from __future__ import annotations

import contextlib
import io
import logging
import socket
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import msgpack
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from vlagents.address import Address
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    InvalidInput,
    PolicyFailed,
    Unauthorized,
    VlagentsError,
)
from vlagents.listening import BEGIN, STRANGER, TRANSFER, Acceptor, Guest, Listening
from vlagents.observation import Observation
from vlagents.other_wires.asked import Asked, side_by_side
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire import bulk
from vlagents.wire.deadline import Deadline
from vlagents.wire.link import Link
from vlagents.wire.message import DTYPES, MOST_AXES
from vlagents.wire.stream import LARGEST_BODY, LARGEST_HEADER
from vlagents.wire.zmtp import ZmtpChannel

_log = logging.getLogger(__name__)

LARGEST_FIRST = 32 << 20
"""Most bytes of a message that comes before a token: GR00T's clients send theirs behind the pictures."""
LONGEST_HEAD = 64 << 10
"""Bytes of a `.npy` file in which its head must be."""


def pack(values: Any) -> bytes:
    """Return values as GR00T sends them."""
    try:
        data: Any = msgpack.packb(values, default=_to_map)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(f"This does not travel: {error}") from error
    return data


def unpack(data: bytes | memoryview, *, most: int = LARGEST_HEADER) -> Any:
    """Read what GR00T sent. Large arrays lie in the data; all can be written if the data can.

    Args:
        data: The message.
        most: Most bytes of what is no large array.

    Raises:
        BadMessage: It is none of its messages, or has more than that.
    """
    return bulk.unpack(data, _from_map, most=most)


class GrootClient(Asked):
    """Asks a server of GR00T, at `gr00t://host:port`. An observation's images and state have GR00T's names."""

    _channel: ZmtpChannel | None = None

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode there too."""
        super().reset(session, instruction, seed=seed)
        with self._lock:
            self._call("reset", {"options": None})

    def ping(self) -> dict[str, Any]:
        """Return what the server says about itself."""
        with self._lock:
            answer = self._call("ping", None)
        return dict(answer) if isinstance(answer, Mapping) else {}

    def _ask(self, observation: Observation, instruction: str) -> NDArray[Any]:
        seen = {
            "video": {name: observation.image(name)[None, None] for name in observation.images},
            "state": {name: np.asarray(part, np.float32)[None, None] for name, part in observation.state.items()},
            "language": {"task": [[instruction]]},
        }
        answer = self._call("get_action", {"observation": seen, "options": None})
        parts = answer[0] if isinstance(answer, (list, tuple)) and answer else None
        if not isinstance(parts, Mapping) or not all(
            isinstance(part, np.ndarray) and part.ndim == 3 and len(part) == 1 for part in parts.values()
        ):
            raise BadMessage(f"The answer of {self.address} is not [{{part: (1, horizon, size)}}, info].")
        return side_by_side({str(name): part[0] for name, part in parts.items()}, self._metadata, self.address)

    def close(self) -> None:
        """End the connection. A second call does nothing."""
        with self._lock:
            self._lose()

    def _open(self, deadline: Deadline) -> ZmtpChannel:
        try:
            connection = socket.create_connection((self.address.host, self.address.port), timeout=self.timeout)
        except TimeoutError as error:
            raise deadline.exceeded() from error
        except OSError as error:
            raise ConnectionLost(f"Nobody is at {self.address}: {error}.") from error
        channel = ZmtpChannel(Link(connection), is_client=True)
        channel.greet(deadline)
        return channel

    def _lose(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _call(self, endpoint: str, data: Any) -> Any:
        request: dict[str, Any] = {"endpoint": endpoint}
        if data is not None:
            request["data"] = data
        if self._token is not None:
            request["api_token"] = self._token
        message = pack(request)
        deadline = Deadline(self.timeout, f"The answer of {self.address} to {endpoint}")
        try:
            if self._channel is None:
                self._channel = self._open(deadline)
            self._channel.send(message, deadline)
            answer = unpack(self._channel.receive(deadline))
        except VlagentsError:
            self._lose()  # whoever was late cannot be asked over the same connection again
            raise
        if isinstance(answer, Mapping) and "error" in answer:
            raise PolicyFailed(f"{self.address} failed: {str(answer['error'])[:4000]}")
        return answer


class GrootServer:
    """Answers GR00T's clients with a policy. Each connection has a session of its own."""

    def __init__(self, policy: Policy, *, host: str = "127.0.0.1", port: int = 5555, token: str | None = None) -> None:
        """Prepare; `start` or a `with` block opens the socket.

        Args:
            policy: It is closed with the server.
            host: As in `Listening`.
            port: As in `Listening`.
            token: As in `Listening`; clients send it as `api_token`, in clear.

        Raises:
            InvalidInput: The address is open to others and there is no token.
        """
        self._listening = Listening(host=host, port=port, token=token)
        self.service = Service(policy, token=token)
        self._acceptor = Acceptor()
        self._port = port

    @property
    def address(self) -> Address:
        """Where the server listens."""
        return Address("gr00t", host=self._listening.host, port=self._port)

    def start(self) -> GrootServer:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port cannot be had.
        """
        listener = self._listening.open()
        self._port = listener.getsockname()[1]
        self._acceptor.listen(listener, self._converse)
        return self

    def close(self) -> None:
        """End all connections, then close the policy, as `Service.close` does. A second call does nothing."""
        self._acceptor.close()
        self.service.close()

    def __enter__(self) -> GrootServer:
        """Start."""
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _converse(self, guest: Guest) -> None:
        """Answer one connection until it ends."""
        caller = self.service.caller(guest.name)
        channel = ZmtpChannel(Link(guest.connection), is_client=False)
        try:
            channel.greet(Deadline(BEGIN, "a greeting of ZeroMQ"))
            while not self._acceptor.is_closing.is_set():
                self._answer_one(channel, guest, caller)
        except ConnectionLost:
            pass
        except VlagentsError as error:
            if not self._acceptor.is_closing.is_set():
                _log.warning("The connection of %s was ended: %s", guest.name, error)
        finally:
            channel.close()
            self.service.forget(caller)

    def _answer_one(self, channel: ZmtpChannel, guest: Guest, caller: Caller) -> None:
        may_send_all = caller.is_known or self._listening.token is None
        channel.largest = LARGEST_BODY if may_send_all else LARGEST_FIRST
        data = channel.receive(Deadline(None, ""), Deadline(TRANSFER, "the rest of a message"))
        try:
            request = unpack(data, most=LARGEST_HEADER if may_send_all else STRANGER)
            if not isinstance(request, Mapping):
                raise BadMessage("A request is no dictionary.")
            self.service.admit(caller, request.get("api_token"))
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                said = "Unauthorized: Invalid API token" if isinstance(error, Unauthorized) else _told(error)
                channel.send(pack({"error": said}), Deadline(TRANSFER, "reading of an answer"))
            raise
        guest.is_known = True
        channel.send(pack(self._answer(caller, request)), Deadline(TRANSFER, "reading of an answer"))

    def _answer(self, caller: Caller, request: Mapping[str, Any]) -> Any:
        given = request.get("data")
        try:
            return self._act(caller, request.get("endpoint"), given if isinstance(given, Mapping) else {})
        except Exception as error:  # noqa: BLE001  whatever a policy raises, the client is told
            if not isinstance(error, VlagentsError):
                _log.exception("The policy failed to answer")
            return {"error": _told(error)}

    def _act(self, caller: Caller, endpoint: object, data: Mapping[str, Any]) -> Any:
        if endpoint == "ping":
            return {"status": "ok", "message": "Server is running", **self.service.health()}
        if endpoint == "reset":
            self.service.reset(caller, "", "", None, None)
            return {}
        if endpoint == "get_modality_config":
            return self.service.metadata.to_dict()
        if endpoint != "get_action":
            raise InvalidInput(f"There is no endpoint {endpoint!r:.80}; valid: get_action, reset, ping.")
        chunk = self.service.infer(caller, _observation(data.get("observation")))
        actions = np.asarray(chunk["actions"], np.float32)
        found, at = {}, 0
        for part in self.service.metadata.action:
            found[part.name] = actions[None, :, at : at + part.size]
            at += part.size
        return [found, dict(chunk["info"])]


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _observation(given: Any) -> Observation:
    """Read GR00T's observation: the newest moment of the only copy."""
    seen: dict[str, Any] = dict(given) if isinstance(given, Mapping) else {}
    parts: dict[str, dict[str, Any]] = {}
    for what, axes in (("video", 5), ("state", 3)):
        found = seen.get(what) or {}
        if not isinstance(found, Mapping) or not all(
            isinstance(array, np.ndarray) and array.ndim == axes and len(array) == 1 and array.shape[1] >= 1
            for array in found.values()
        ):
            raise InvalidInput(f"{what} is not made of arrays with {axes} axes of one copy.")
        parts[what] = {str(name): array[0, -1] for name, array in found.items()}
    said = seen.get("language") or {}
    first = next(iter(said.values()), "") if isinstance(said, Mapping) else ""
    while isinstance(first, (list, tuple)) and first:
        first = first[0]
    return Observation(parts["video"], parts["state"], first if isinstance(first, str) else "")


def _to_map(value: object) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.str not in DTYPES:
            raise InvalidInput(f"An array of dtype {value.dtype} does not travel; valid: {', '.join(sorted(DTYPES))}.")
        file = io.BytesIO()
        np.save(file, value, allow_pickle=False)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}
    if isinstance(value, np.generic):
        return value.item()
    raise InvalidInput(f"{type(value).__name__} does not travel; valid are plain values and NumPy arrays.")


def _from_map(found: dict[Any, Any]) -> Any:
    return array_from_npy(found.get("as_npy")) if found.get("__ndarray_class__") is True else found


def array_from_npy(data: object) -> NDArray[Any]:
    """Return the array of a `.npy` file's bytes; its size is checked before anything is allocated.

    Args:
        data: The file. The array of a memoryview lies in it, that of bytes is a copy.

    Raises:
        BadMessage: It is none, or one of objects.
    """
    if not isinstance(data, (bytes, memoryview)):
        raise BadMessage("An array has no bytes.")
    file = io.BytesIO(data[:LONGEST_HEAD])
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    except Exception as error:  # whatever NumPy raises for what is no such file
        raise BadMessage(f"An array is no .npy file: {type(error).__name__}.") from error
    if dtype.str not in DTYPES or any(n < 0 for n in shape) or len(shape) > MOST_AXES:
        raise BadMessage(
            f"An array has the dtype {dtype.str!r:.40} and {len(shape)} axes; valid are up to {MOST_AXES} axes of "
            f"{', '.join(sorted(DTYPES))}."
        )
    try:
        flat = np.frombuffer(data, dtype, offset=file.tell())
        array = flat.reshape(shape, order="F" if is_fortran else "C")
    except ValueError as error:
        raise BadMessage(f"An array of shape {shape} has {len(data) - file.tell()} bytes.") from error
    return array.copy() if isinstance(data, bytes) else array
