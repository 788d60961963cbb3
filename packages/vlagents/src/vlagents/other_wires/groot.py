"""GR00T's wire, both ways: ZeroMQ requests and replies of msgpack, with arrays as the bytes of `.npy` files.

Layout as in Isaac-GR00T's `gr00t/policy/server_client.py`: a request is `{"endpoint", "data", "api_token"}`. The
data of `get_action` are `{"observation": {"video": {camera: uint8 [B, T, H, W, 3]}, "state": {part: float32
[B, T, D]}, "language": {"task": [[str]]}}, "options"}`, and `[{part: float32 [B, T, D]}, info]` comes back; an error is
`{"error": str}`. Files of pickled objects are refused, and there is no endpoint `kill` here.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, InvalidInput, PolicyFailed, Unauthorized, VlagentsError
from vlagents.metadata import split
from vlagents.observation import Observation
from vlagents.remote import RemotePolicy
from vlagents.service import Caller
from vlagents.wire import bulk
from vlagents.wire.link import Deadline, Link, dial
from vlagents.wire.message import array_of, encode
from vlagents.wire.stream import LARGEST_HEADER
from vlagents.wire.zmtp import ZmtpChannel
from vlagents.wire_server import BEGIN, STRANGER, Guest, WireServer

LARGEST_FIRST = 32 << 20
"""Most bytes of a message before the token is known: GR00T's clients send it behind the images."""
LONGEST_HEAD = 64 << 10
"""Most bytes of the header of a `.npy` file."""


def pack(values: Any) -> bytes:
    """Return values as GR00T sends them.

    Raises:
        InvalidInput: A value does not travel.
    """
    return encode(values, _array_to_map)


def unpack(data: bytes | memoryview, *, most: int = LARGEST_HEADER) -> Any:
    """Read a message of GR00T. Large arrays are views of the data; all are writable if the data is.

    Args:
        data: The message.
        most: Most bytes beside large arrays.

    Raises:
        BadMessage: It is no such message, or has more bytes than that.
    """
    return bulk.unpack(data, _from_map, most=most)


class GrootClient(RemotePolicy):
    """Calls a server of GR00T, at `gr00t://host:port`. An observation's images and state have GR00T's names."""

    schemes = ("gr00t",)
    _channel: ZmtpChannel | None

    def ping(self) -> dict[str, Any]:
        """Return the health of the server."""
        with self._lock:
            answer = self._call("ping", None)
        return dict(answer) if isinstance(answer, Mapping) else {}

    def _tell(self, call: str, **given: Any) -> None:
        if call == "reset":
            self._call("reset", {"options": None})

    def _infer(self, observation: Observation) -> Chunk:
        seen = {
            "video": {name: observation.image(name)[None, None] for name in observation.images},
            "state": {name: np.asarray(part, np.float32)[None, None] for name, part in observation.state.items()},
            "language": {"task": [[self._instructed(observation).instruction]]},
        }
        answer = self._call("get_action", {"observation": seen, "options": None})
        parts = answer[0] if isinstance(answer, (list, tuple)) and answer else None
        if not isinstance(parts, Mapping) or not parts:
            raise BadMessage(f"The answer of {self.address} is not [{{part: (1, horizon, size)}}, info].")
        columns = []
        for name in [part.name for part in self._metadata.action] or list(parts):
            part = parts.get(name)
            if not isinstance(part, np.ndarray) or part.dtype.kind not in "fiu" or part.ndim != 3 or len(part) != 1:
                raise BadMessage(
                    f"The answer of {self.address} has no {name!r} of shape (1, horizon, size); it has {list(parts)}."
                )
            columns.append(part[0])
        if len({len(part) for part in columns}) != 1:
            raise BadMessage(f"The answer of {self.address} has parts of different numbers of rows.")
        return self._chunk(np.concatenate(columns, axis=1), observation.time)

    def _connect(self) -> None:
        channel = ZmtpChannel(Link(dial(self.address, self.timeout)), is_client=True)
        channel.greet(Deadline(self.timeout, f"The greeting of {self.address}"))
        self._channel = channel

    def _call(self, endpoint: str, data: Any) -> Any:
        request: dict[str, Any] = {"endpoint": endpoint}
        if data is not None:
            request["data"] = data
        if self._token is not None:
            request["api_token"] = self._token
        message = pack(request)
        deadline = Deadline(self.timeout, f"The answer of {self.address} to {endpoint}")
        channel = self._connected()
        try:
            channel.send(message, deadline)
            answer = unpack(channel.receive(deadline))
        except VlagentsError:
            self._lose(channel)  # a late answer must not be taken for the next one
            raise
        if isinstance(answer, Mapping) and "error" in answer:
            raise PolicyFailed(f"{self.address} failed: {str(answer['error'])[:4000]}")
        return answer


class GrootServer(WireServer):
    """Answers GR00T's clients with a policy. Each connection has a session of its own."""

    schemes = ("gr00t", None)

    def _open(self, guest: Guest) -> ZmtpChannel:
        channel = ZmtpChannel(Link(guest.connection), is_client=False)
        channel.greet(Deadline(BEGIN, "a greeting of ZeroMQ"))
        return channel

    def _answer_one(self, guest: Guest, channel: ZmtpChannel) -> None:
        may_send_all = guest.is_known or not self.service.has_token
        channel.largest = self._largest if may_send_all else LARGEST_FIRST
        data = channel.receive(Deadline(None, ""), self._rest())
        try:
            request = unpack(data, most=LARGEST_HEADER if may_send_all else STRANGER)
            if not isinstance(request, Mapping):
                raise BadMessage("A request is no dictionary.")
            self.service.admit(guest, request.get("api_token"))
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                said = "Unauthorized: Invalid API token" if isinstance(error, Unauthorized) else str(error)
                channel.send(pack({"error": said}), self._rest())
            raise
        channel.send(pack(self._answer(guest, request)), self._rest())

    def _answer(self, caller: Caller, request: Mapping[str, Any]) -> Any:
        given = request.get("data")
        try:
            return self._act(caller, request.get("endpoint"), given if isinstance(given, Mapping) else {})
        except Exception as error:  # noqa: BLE001  the client gets whatever a policy raises
            return {"error": self.service.failure(caller, error)["text"]}

    def _act(self, caller: Caller, endpoint: object, data: Mapping[str, Any]) -> Any:
        if endpoint == "ping":
            return {"status": "ok", "message": "Server is running", **self.service.health()}
        if endpoint == "reset":
            self.service.reset(caller, "", "", None, None)
            return {}
        if endpoint != "get_action":
            raise InvalidInput(f"There is no endpoint {endpoint!r:.80}; valid: get_action, reset, ping.")
        chunk = self.service.infer(caller, _observation(data.get("observation")))
        actions = np.asarray(chunk["actions"], np.float32)
        return [split(actions[None], self.service.metadata.action), dict(chunk["info"])]


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


def _array_to_map(array: NDArray[Any]) -> dict[str, Any]:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": file.getvalue()}


def _from_map(found: dict[Any, Any]) -> Any:
    return array_from_npy(found.get("as_npy")) if found.get("__ndarray_class__") is True else found


def array_from_npy(data: object) -> NDArray[Any]:
    """Return the array of a `.npy` file's bytes; its size is checked before anything is allocated.

    Args:
        data: The file. The array of a memoryview is a view of it, that of bytes is a copy.

    Raises:
        BadMessage: It is no such file, or one of objects.
    """
    if not isinstance(data, (bytes, memoryview)):
        raise BadMessage("An array has no bytes.")
    file = io.BytesIO(data[:LONGEST_HEAD])
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    except Exception as error:  # whatever NumPy raises for other bytes
        raise BadMessage(f"An array is no .npy file: {type(error).__name__}.") from error
    array = array_of(memoryview(data)[file.tell() :], dtype.str, list(shape[::-1] if is_fortran else shape))
    array = array.T if is_fortran else array
    return array.copy() if isinstance(data, bytes) else array
