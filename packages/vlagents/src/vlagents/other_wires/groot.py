"""GR00T's wire, both ways: ZeroMQ requests and replies of msgpack, with arrays as the bytes of `.npy` files.

Layout as in Isaac-GR00T's `gr00t/policy/server_client.py`: `{"endpoint", "data", "api_token"}` goes there. Of
`get_action`, the data are `{"observation": {"video": {camera: uint8 [B, T, H, W, 3]}, "state": {part: float32
[B, T, D]}, "language": {"task": [[str]]}}, "options"}`, and `[{part: float32 [B, T, D]}, info]` comes back; an error is
`{"error": str}`. Files of pickled objects are refused, and the endpoint `kill` does not exist here.
"""

from __future__ import annotations

import hmac
import importlib
import io
import logging
import threading
from collections import OrderedDict
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import msgpack
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from vlagents.address import Address
from vlagents.errors import (
    AddressTaken,
    BadMessage,
    DeadlineExceeded,
    InvalidInput,
    MissingStack,
    PolicyFailed,
    VlagentsError,
)
from vlagents.listening import MOST_CALLERS, Listening
from vlagents.observation import Observation
from vlagents.other_wires.asked import Asked, side_by_side
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire.message import DTYPES
from vlagents.wire.stream import LARGEST_BODY

_log = logging.getLogger(__name__)


def pack(values: Any) -> bytes:
    """Return values as GR00T sends them."""
    try:
        data: Any = msgpack.packb(values, default=_to_map)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(f"This does not travel: {error}") from error
    return data


def unpack(data: bytes) -> Any:
    """Read what GR00T sent; arrays are read-only.

    Raises:
        BadMessage: It is none of its messages.
    """
    try:
        return msgpack.unpackb(data, object_hook=_from_map, strict_map_key=True)
    except BadMessage:
        raise
    except Exception as error:  # whatever msgpack raises for what is no msgpack
        raise BadMessage(f"This is no msgpack: {type(error).__name__}: {error}.") from error


class GrootClient(Asked):
    """Asks a server of GR00T, at `gr00t://host:port`. An observation's images and state have GR00T's names."""

    _asks: Any = None
    _context: Any = None

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

    def _open(self) -> Any:
        zmq = _zmq()
        self._context = zmq.Context()
        asks = self._asks = self._context.socket(zmq.REQ)
        asks.setsockopt(zmq.LINGER, 0)
        asks.setsockopt(zmq.MAXMSGSIZE, LARGEST_BODY)
        asks.connect(f"tcp://{self.address.host}:{self.address.port}")
        return asks

    def _lose(self) -> None:
        asks, self._asks = self._asks, None
        if asks is not None:
            asks.close()
            self._context.term()

    def _call(self, endpoint: str, data: Any) -> Any:
        request: dict[str, Any] = {"endpoint": endpoint}
        if data is not None:
            request["data"] = data
        if self._token is not None:
            request["api_token"] = self._token
        data = pack(request)
        asks = self._asks if self._asks is not None else self._open()
        asks.send(data, copy=False)
        if not asks.poll(1e3 * self.timeout):
            self._lose()  # whoever was late cannot be asked over the same socket again
            raise DeadlineExceeded(f"{self.address} did not answer {endpoint} within {self.timeout:g} s.")
        try:
            answer = unpack(asks.recv())
        except BadMessage:
            self._lose()
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
            MissingStack: There is no pyzmq.
        """
        self._listening = Listening(host=host, port=port, token=token)
        self._zmq = _zmq()
        self.service = Service(policy)
        self._port = port
        self._is_closing = threading.Event()
        self._thread: threading.Thread | None = None
        self._callers: OrderedDict[bytes, Caller] = OrderedDict()

    @property
    def address(self) -> Address:
        """Where the server listens."""
        return Address("gr00t", host=self._listening.host, port=self._port)

    def start(self) -> GrootServer:
        """Listen, and answer in a thread of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port cannot be had.
        """
        zmq = self._zmq
        context = zmq.Context()
        replies = context.socket(zmq.ROUTER)
        replies.setsockopt(zmq.LINGER, 0)
        replies.setsockopt(zmq.MAXMSGSIZE, LARGEST_BODY)
        try:
            replies.bind(f"tcp://{self._listening.host}:{self._port or '*'}")
        except zmq.ZMQError as error:
            replies.close()
            context.term()
            if error.errno == zmq.EADDRINUSE:
                raise AddressTaken(self._listening.host, self._port) from error
            raise OSError(f"Port {self._port} cannot be had: {error}") from error
        self._port = int(replies.getsockopt(zmq.LAST_ENDPOINT).decode().rsplit(":", 1)[1])
        self._thread = threading.Thread(target=self._serve, args=(context, replies), name="vlagents gr00t", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """Listen no more, then close the policy. A second call does nothing."""
        self._is_closing.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self.service.close()

    def __enter__(self) -> GrootServer:
        """Start."""
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _serve(self, context: Any, replies: Any) -> None:
        while not self._is_closing.is_set():
            if not replies.poll(100):
                continue
            frames = replies.recv_multipart()
            if len(frames) != 3 or frames[1]:
                continue  # this is no request
            replies.send_multipart([frames[0], b"", pack(self._answer(frames[0], frames[2]))], self._zmq.NOBLOCK)
        replies.close()
        context.term()

    def _answer(self, name: bytes, data: bytes) -> Any:
        try:
            request = unpack(data)
            if not isinstance(request, Mapping):
                raise BadMessage("A request is no dictionary.")
            token = request.get("api_token")
            if self._listening.token is not None and not hmac.compare_digest(
                (token if isinstance(token, str) else "").encode(), self._listening.token.encode()
            ):
                return {"error": "Unauthorized: Invalid API token"}
            given = request.get("data")
            return self._act(self._caller(name), request.get("endpoint"), given if isinstance(given, Mapping) else {})
        except VlagentsError as error:
            return {"error": f"{type(error).__name__}: {error}"}
        except Exception as error:  # noqa: BLE001  whatever a policy raises, the client is told
            _log.exception("The policy failed to answer")
            return {"error": f"{type(error).__name__}: {error}"}

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

    def _caller(self, name: bytes) -> Caller:
        if name not in self._callers:
            self._callers[name] = self.service.caller(f"gr00t {name.hex()}")
            if len(self._callers) > MOST_CALLERS:  # ZeroMQ does not tell who has gone
                self.service.forget(self._callers.popitem(last=False)[1])
        self._callers.move_to_end(name)
        return self._callers[name]


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
    """Return the array of a `.npy` file's bytes, in which it lies; its size is checked before anything is allocated.

    Raises:
        BadMessage: It is none, or one of objects.
    """
    if not isinstance(data, bytes):
        raise BadMessage("An array has no bytes.")
    file = io.BytesIO(data)
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    except Exception as error:  # whatever NumPy raises for what is no such file
        raise BadMessage(f"An array is no .npy file: {type(error).__name__}.") from error
    if dtype.str not in DTYPES or any(n < 0 for n in shape):
        raise BadMessage(f"An array has the dtype {dtype.str!r:.40}; valid: {', '.join(sorted(DTYPES))}.")
    try:
        flat = np.frombuffer(data, dtype, offset=file.tell())
        return flat.reshape(shape, order="F" if is_fortran else "C")
    except ValueError as error:
        raise BadMessage(f"An array of shape {shape} has {len(data) - file.tell()} bytes.") from error


def _zmq() -> Any:
    try:
        return importlib.import_module("zmq")
    except ImportError as error:
        raise MissingStack("gr00t", "pyzmq", is_wire=True) from error
