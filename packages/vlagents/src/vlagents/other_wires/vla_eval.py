"""The wire of vla-eval: its benchmarks are clients, over a websocket of msgpack, and our policies answer.

Layout as in vla-eval's `protocol/`: a message is `{"type", "payload", "seq", "timestamp"}`. `hello` is answered by
`hello`; `episode_start` has the task; the payload of `observation` is `{"images": {camera: uint8 (H, W, 3)},
"task_description": str, part: numbers (n,)}`, and is answered by `action`, `{"actions": float32 (size,)}`, with its
number, or by `error`. An array is `{"__ndarray__", "data", "dtype", "shape"}`, an image `{"__image__", "format",
"data", "shape"}` with a PNG, a JPEG or raw bytes. An observation gets one action: the rows of a chunk answer as many.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import BadMessage, InvalidInput
from vlagents.jpeg import decoded
from vlagents.observation import Observation
from vlagents.websocket import WebsocketServer
from vlagents.wire import bulk
from vlagents.wire.frames import FrameChannel
from vlagents.wire.link import Deadline
from vlagents.wire.message import array_of, encode
from vlagents.wire_server import Guest

PROTOCOL = 1
"""Version of the messages."""
INSTRUCTION = "task_description"


class VlaEvalServer(WebsocketServer):
    """Answers the benchmarks of vla-eval with a policy; each connection has a session of its own.

    The policy's images and parts of the state have the benchmark's names. A token is sent as `Authorization: Bearer
    TOKEN`, which vla-eval's client does not do: serve it on the benchmark's machine.
    """

    schemes = ("ws", None)
    _health = ("/health", '{"status": "ok"}\n')

    def _start_more(self) -> None:
        super()._start_more()
        self._rows: WeakKeyDictionary[Guest, deque[NDArray[np.float32]]] = WeakKeyDictionary()

    def _greet(self, guest: Guest, channel: FrameChannel) -> None:
        self._rows[guest] = deque()  # the client begins

    def _answer_one(self, guest: Guest, channel: FrameChannel) -> None:
        message = channel.receive(Deadline(None, ""), self._rest())
        values = None if isinstance(message, str) else bulk.unpack(message, _from_map)
        if not isinstance(values, Mapping) or not isinstance(values.get("payload"), Mapping):
            raise BadMessage("This is no message of vla-eval: a dictionary with type, payload, seq and timestamp.")
        kind, number = values.get("type"), values.get("seq")
        try:
            found = self._reply(guest, kind, values["payload"])
        except Exception as error:  # noqa: BLE001  the benchmark counts the episode as an error and goes on
            found = "error", {"error": self.service.failure(guest, error)["text"]}
        if found is not None:
            answer = {"type": found[0], "payload": found[1], "seq": number, "timestamp": time.time()}
            channel.send([encode(answer, _array_to_map)], self._rest())

    def _reply(self, guest: Guest, kind: object, payload: Mapping[str, Any]) -> tuple[str, dict[str, Any]] | None:
        metadata, rows = self.service.metadata, self._rows[guest]
        if kind == "hello":
            own = f"vlagents {self.service.health()['version']}"
            hello = {"harness_version": own, "protocol_version": PROTOCOL}
            # Benchmarks that have such options show what the policy needs.
            shown = {
                "send_state": bool(metadata.state),
                "send_wrist_image": any("wrist" in i.name for i in metadata.images),
            }
            return "hello", {**hello, "model_server": metadata.name, "capabilities": {}, "observation_params": shown}
        if kind == "episode_start":
            rows.clear()
            task = payload.get("task")
            self.service.reset(guest, "", str(task.get("name", "")) if isinstance(task, Mapping) else "", None, None)
            return None
        if kind == "observation":
            if not rows:
                rows.extend(np.asarray(self.service.infer(guest, _observation(payload))["actions"], np.float32))
            return "action", {"actions": rows.popleft()}
        if kind in ("episode_end", "error"):
            return None
        raise InvalidInput(
            f"A message is of the type {kind!r:.40}; valid: hello, episode_start, observation, episode_end."
        )


def _observation(payload: Mapping[str, Any]) -> Observation:
    images = payload.get("images")
    instruction = payload.get(INSTRUCTION, "")
    state = {
        str(name): np.asarray(value, np.float64)
        for name, value in payload.items()
        if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiub"
    }
    return Observation(
        dict(images) if isinstance(images, Mapping) else {}, state, instruction if isinstance(instruction, str) else ""
    )


def _array_to_map(array: NDArray[Any]) -> dict[str, Any]:
    return {"__ndarray__": True, "data": array.tobytes(), "dtype": array.dtype.str, "shape": list(array.shape)}


def _from_map(found: dict[Any, Any]) -> Any:
    if "__ndarray__" not in found and "__image__" not in found:
        return found
    data = found.get("data")
    if "__image__" not in found or found.get("format") == "raw":
        return array_of(data, found.get("dtype"), found.get("shape"))
    if not isinstance(data, (bytes, memoryview)):
        raise BadMessage("An image has no bytes.")
    try:
        return np.array(decoded(data, "PNG", "JPEG"))
    except InvalidInput as error:
        raise BadMessage(str(error)) from error
