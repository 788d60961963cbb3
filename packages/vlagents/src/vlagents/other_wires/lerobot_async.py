"""LeRobot's asynchronous wire, as a client only: gRPC whose messages are pickles, of which none is ever run here.

Layout as in LeRobot 0.4.4's `transport/services.proto`, package `transport`: `Ready`, `SendPolicyInstructions` with the
checkpoint that the server is to load, `SendObservations` in pieces of 2 MB, and `GetActions`. The server unpickles what
anybody sends to it, which is CVE-2026-25874; so whoever asks one says `accepts="CVE-2026-25874"`.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    DeadlineExceeded,
    InvalidInput,
    MissingStack,
    PolicyFailed,
    Unauthorized,
)
from vlagents.observation import Observation
from vlagents.other_wires import inert
from vlagents.other_wires.asked import Asked
from vlagents.wire.deadline import Deadline

CVE = "CVE-2026-25874"
"""LeRobot's server unpickles what anybody sends to it: it runs the code of whoever reaches its port."""
LARGEST = 32 << 20
"""Most bytes of an answer."""
PIECE = 2 << 20
"""Bytes of an observation in one message."""
_SERVICE = "/transport.AsyncInference/"
_BEGIN, _MIDDLE, _END = 1, 2, 3
_HELPERS = "lerobot.async_inference.helpers"


class LerobotClient(Asked):
    """Asks LeRobot's `policy_server`, at `lerobot+grpc://host:port`, which serves one robot at a time.

    Example:
        >>> from vlagents import ImageSpec, Metadata, PartSpec
        >>> joints = PartSpec("joints", 6, "rad")
        >>> images = (ImageSpec("wrist", 48, 64),)
        >>> told = Metadata(name="act", images=images, state=(joints,), action=(joints,), rate=30.0)
        >>> client = LerobotClient(
        ...     "lerobot+grpc://127.0.0.1:8080", policy="act", checkpoint="/models/act", metadata=told,
        ...     accepts="CVE-2026-25874",
        ... )  # doctest: +SKIP
    """

    def __init__(
        self,
        address: str,
        *,
        policy: str = "",
        checkpoint: str = "",
        device: str = "cpu",
        accepts: str = "",
        loading: float = 120.0,
        **options: Any,
    ) -> None:
        """Set what the server is told; it is asked nothing before the first `reset` or `infer`.

        Args:
            address: Where the server is.
            policy: LeRobot's name of the policy's type, such as `act`, `smolvla` or `pi0`.
            checkpoint: Folder on the server's machine, or a name on the hub, that the server is to load.
            device: Where the server is to run it.
            accepts: `CVE-2026-25874`, to say that nobody but you reaches that server.
            loading: How long it may take to load the checkpoint [s].
            options: As of `Asked`. The metadata are needed: images with their sizes, and the parts of the state in the
                order of the checkpoint's. The server knows no token.

        Raises:
            InvalidInput: The risk is not accepted, or an option is missing or wrong.
            MissingStack: There is no grpcio.
        """
        if accepts != CVE:
            raise InvalidInput(
                f"LeRobot's server runs the code of whoever reaches its port ({CVE}), and anybody on the way can read "
                f"and change what is sent. Keep it at 127.0.0.1 or behind a tunnel, and say accepts={CVE!r}."
            )
        if options.get("token") is not None:
            raise InvalidInput(f"{address} knows no token; leave it out, and let nobody else reach the server.")
        super().__init__(address, **options)
        told = self._metadata
        unsized = [image.name for image in told.images if not (image.height and image.width)]
        if not (policy and checkpoint and told.state and told.action) or unsized:
            raise InvalidInput(
                "LeRobot's server needs `policy`, `checkpoint`, and `metadata` with the state, the action and the size "
                f"of each image{f'; {unsized} have none' if unsized else ''}."
            )
        self._grpc = _grpc()
        self._instructions = inert.write(
            _made(
                "RemotePolicyConfig",
                policy_type=policy,
                pretrained_name_or_path=checkpoint,
                lerobot_features=self._features(),
                actions_per_chunk=told.horizon,
                device=device,
                rename_map={},
            )
        )
        self._loading = float(loading)
        self._channel: Any = None
        self._step = 0

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Remember what is to be done; the first time, have the server load the checkpoint.

        Raises:
            ConnectionLost: Nobody is there.
            DeadlineExceeded: It did not load it in time.
            PolicyFailed: The server could not load it; it may say why.
        """
        super().reset(session, instruction, seed=seed)
        with self._lock:
            self._open()

    def close(self) -> None:
        """End the connection. A second call does nothing."""
        with self._lock:
            self._lose()

    def _ask(self, observation: Observation, instruction: str) -> NDArray[Any]:
        self._open()
        self._step += 1
        seen = _made(
            "TimedObservation",
            timestamp=time.time(),  # by the server's clock: it logs how late an observation comes
            timestep=self._step,
            observation=self._raw(observation, instruction),
            must_go=True,  # or the server leaves out observations that it finds alike
        )
        deadline = Deadline(self.timeout, f"The answer of {self.address}")
        self._call("SendObservations", _pieces(inert.write(seen)), deadline)
        answer = only_field(self._call("GetActions", b"", deadline))
        if not answer:
            raise PolicyFailed(f"{self.address} gave no actions; its log has the reason.")
        return self._actions(inert.read(answer))

    def _actions(self, chunk: Any) -> NDArray[Any]:
        """Return the rows of a chunk that answers the present observation."""
        rows, steps = [], []
        for timed in chunk if isinstance(chunk, list) else [None]:
            state = timed.state if isinstance(timed, inert.Call) and timed.function == inert.TIMED_ACTION else None
            if not isinstance(state, dict):
                raise BadMessage(f"The answer of {self.address} is no list of timed actions.")
            rows.append(inert.numbers(state.get("action")).reshape(-1))
            steps.append(state.get("timestep"))
        if not rows or len({len(row) for row in rows}) != 1:
            raise BadMessage(f"The answer of {self.address} has {len(rows)} actions, of different sizes or none.")
        if steps != list(range(self._step, self._step + len(steps))):
            self._lose()  # whatever else it has of before is not asked for
            raise BadMessage(
                f"The answer of {self.address} is to another observation; its steps are {steps[:4]!r:.80}."
            )
        return np.stack(rows)

    def _features(self) -> dict[str, Any]:
        """Return what is observed, as LeRobot's datasets say it."""
        names = [f"{part.name}.{i}" for part in self._metadata.state for i in range(part.size)]
        features: dict[str, Any] = {
            "observation.state": {"dtype": "float32", "shape": (len(names),), "names": names},
        }
        for image in self._metadata.images:
            shape = (image.height, image.width, 3)
            about = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
            features[f"observation.images.{image.name}"] = about
        return features

    def _raw(self, observation: Observation, instruction: str) -> dict[str, Any]:
        raw: dict[str, Any] = {"task": instruction}
        for part in self._metadata.state:
            values = np.asarray(observation.state.get(part.name, ()), np.float64)
            if values.shape != (part.size,):
                raise InvalidInput(f"state[{part.name!r}] has the shape {values.shape}; valid is ({part.size},).")
            raw |= {f"{part.name}.{i}": float(value) for i, value in enumerate(values)}
        for image in self._metadata.images:
            raw[image.name] = observation.image(image.name)
        return raw

    def _open(self) -> None:
        """Connect, unless that is done, and have the checkpoint loaded."""
        if self._channel is not None:
            return
        options = [("grpc.max_receive_message_length", LARGEST), ("grpc.max_send_message_length", LARGEST)]
        host = f"[{self.address.host}]" if ":" in self.address.host else self.address.host
        self._channel = self._grpc.insecure_channel(f"{host}:{self.address.port}", options=options)
        self._call("Ready", b"", Deadline(self.timeout, f"A word from {self.address}"))
        loaded = Deadline(self._loading, f"The checkpoint that {self.address} loads")
        self._call("SendPolicyInstructions", field(1, self._instructions), loaded)

    def _lose(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _call(self, name: str, given: bytes | Iterator[bytes], deadline: Deadline) -> bytes:
        kind = self._channel.unary_unary if isinstance(given, bytes) else self._channel.stream_unary
        # Bytes go out and come in as they are: the messages are simple enough to be written here.
        call = kind(_SERVICE + name, request_serializer=None, response_deserializer=None)
        codes = self._grpc.StatusCode
        try:
            return call(given, timeout=deadline.left())
        except self._grpc.RpcError as error:
            self._lose()
            code, told = error.code(), str(error.details())[:4000]
            if code == codes.DEADLINE_EXCEEDED:
                raise deadline.exceeded() from error
            if code == codes.UNAVAILABLE:
                raise ConnectionLost(f"Nobody is at {self.address}, or it has gone: {told}") from error
            if code == codes.RESOURCE_EXHAUSTED:
                raise BadMessage(f"A message is too large for {self.address}: {told}") from error
            if code in (codes.UNAUTHENTICATED, codes.PERMISSION_DENIED):
                raise Unauthorized(f"{self.address} refuses to answer: {told}") from error
            raise PolicyFailed(f"{self.address} failed at {name}: {told}") from error
        except DeadlineExceeded:
            self._lose()
            raise


def _made(kind: str, **fields: Any) -> inert.Call:
    return inert.Call(inert.Name(_HELPERS, kind), (), fields)


def _pieces(data: bytes) -> Iterator[bytes]:
    """Yield an observation in messages that say which is the first and which the last; a single one is the last."""
    for start in range(0, len(data), PIECE):
        state = _END if start + PIECE >= len(data) else _MIDDLE if start else _BEGIN
        yield bytes([1 << 3, state]) + field(2, data[start : start + PIECE])


# --- Protocol Buffers, as much as is needed ----------------------------------------------------------------------


def field(number: int, data: bytes) -> bytes:
    """Return a field of bytes as a message has it."""
    length, size = len(data), bytearray()
    while length >= 0x80:
        size.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes([number << 3 | 2, *size, length]) + data


def only_field(message: bytes) -> bytes:
    """Return field 1, of bytes, of a message that has no other; nothing if it is empty.

    Raises:
        BadMessage: It is no such message.
    """
    if not message:
        return b""
    length, place = 0, 1
    while place < min(len(message), 6):
        length |= (message[place] & 0x7F) << 7 * (place - 1)
        place += 1
        if message[place - 1] < 0x80:
            break
    if len(message) < 2 or message[0] != 1 << 3 | 2 or length != len(message) - place:
        raise BadMessage("The answer is no message of LeRobot's wire.")
    return message[place:]


def _grpc() -> Any:
    try:
        return importlib.import_module("grpc")
    except ImportError as error:
        raise MissingStack("lerobot+grpc", "grpcio", is_wire=True) from error
