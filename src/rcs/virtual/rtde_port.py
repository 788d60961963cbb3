"""Port 30004 of a virtual UR: RTDE, which exchanges outputs and input registers in real time.

The messages follow version 2 of the vendor's guide "Real-Time Data Exchange": a header of u16 size and u8 type in
network order, and content depending on the type.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from rcs.virtual.line import Line
from rcs.virtual.tcp_port import TcpConnection, TcpPort

VERSION: Final = 2
"""Version of the protocol."""

FORMATS: Final[Mapping[str, str]] = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""Struct format of each type of the protocol."""

INPUTS: Final[Mapping[str, str]] = {
    **{f"input_int_register_{i}": "INT32" for i in range(48)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(48)},
    **{f"input_bit_register_{i}": "BOOL" for i in range(64, 128)},
}
"""Inputs that clients may set, with their types."""


@dataclass(frozen=True)
class Output:
    """An output of the controller."""

    type: str
    """Type in the protocol."""
    read: Callable[[], Any]
    """Returns the present value; a list for vectors."""


@dataclass
class _Recipe:
    """The variables that a client has requested: names, packing and sources."""

    names: list[str]
    packing: struct.Struct
    reads: list[tuple[Callable[[], Any], bool]] = field(default_factory=list[tuple[Callable[[], Any], bool]])
    """For outputs: the function that returns the value, and True if the value is a vector."""

    def packed(self) -> bytes:
        """Return the present outputs."""
        values: list[Any] = []
        for read, is_vector in self.reads:
            values += read() if is_vector else (read(),)
        return self.packing.pack(*values)


@dataclass
class _Client:
    """State of a client's session."""

    outputs: _Recipe | None = None
    ticks_per_output: int = 1
    inputs: dict[int, _Recipe] = field(default_factory=dict[int, _Recipe])
    is_started: bool = False


class RtdePort:
    """Serves all clients of RTDE and stores the values they set in `registers`."""

    def __init__(
        self, port: TcpPort, line: Line, outputs: Mapping[str, Output], software: tuple[int, int, int, int], rate: int
    ) -> None:
        """Serve a port.

        Args:
            port: Port 30004 of the controller.
            line: Line that outputs pass. TCP drops damaged packets, so that none arrives.
            outputs: The outputs by name.
            software: Version of the controller's software.
            rate: Ticks per second [Hz].
        """
        self._port = port
        self._line = line
        self._outputs = outputs
        self._software = software
        self._rate = rate
        self._clients: dict[TcpConnection, _Client] = {}
        self.registers: dict[str, Any] = {name: 0 if kind == "INT32" else 0.0 for name, kind in INPUTS.items()}
        """The input registers by name."""
        self.was_set: set[str] = set()
        """Registers that were set in the present tick."""
        self.version = VERSION
        """Supported version of the protocol."""
        self.heed: Callable[[], object] = lambda: None
        """Callback after registers were set."""

    def receive(self) -> None:
        """Answer received messages."""
        new, ended = self._port.poll()
        for connection in new:
            self._clients[connection] = _Client()
        for connection in ended:
            del self._clients[connection]
        for connection, client in self._clients.items():
            data = connection.received
            while len(data) >= 3:
                size, kind = struct.unpack_from(">HB", data)
                if size < 3:
                    connection.close()
                    break
                if len(data) < size:
                    break
                body = bytes(data[3:size])
                del data[:size]
                answer = self._answer(client, chr(kind), body)
                if answer is not None:
                    connection.send(_message(kind, answer))

    def send(self, tick: int) -> None:
        """Send the outputs of a tick to the clients that requested them."""
        for connection, client in self._clients.items():
            recipe = client.outputs
            if client.is_started and recipe is not None and tick % client.ticks_per_output == 0:
                packet = _message(ord("U"), b"\x01" + recipe.packed())
                self._line.send(packet, partial(_send_whole, connection, packet))

    def _answer(self, client: _Client, kind: str, body: bytes) -> bytes | None:
        match kind:
            case "V":
                return struct.pack(">?", len(body) == 2 and struct.unpack(">H", body)[0] == self.version)
            case "v":
                return struct.pack(">4I", *self._software)
            case "O":
                rate, names = struct.unpack(">d", body[:8])[0], _names(body[8:])
                types = [self._outputs[name].type if name in self._outputs else "NOT_FOUND" for name in names]
                recipe = client.outputs = _recipe(names, types)
                if recipe is not None:
                    outputs = [self._outputs[name] for name in names]
                    recipe.reads = [(output.read, FORMATS[output.type][0].isdigit()) for output in outputs]
                client.ticks_per_output = max(round(self._rate / max(rate, 1.0)), 1)
                return struct.pack(">B", client.outputs is not None) + ",".join(types).encode()
            case "I":
                names = _names(body)
                types = [self._input_type(client, name) for name in names]
                recipe = _recipe(names, types)
                number = 0 if recipe is None else len(client.inputs) + 1
                if recipe is not None:
                    client.inputs[number] = recipe
                return struct.pack(">B", number) + ",".join(types).encode()
            case "S" | "P":
                client.is_started = kind == "S" and client.outputs is not None
                return struct.pack(">?", kind == "P" or client.is_started)
            case "U":
                self._set(client, body)
                return None
            case _:
                return None

    def _input_type(self, client: _Client, name: str) -> str:
        """Return the type of an input, or the reason why this client cannot use it."""
        for other in self._clients.values():
            if other is not client and any(name in recipe.names for recipe in other.inputs.values()):
                return "IN_USE"
        return INPUTS.get(name, "NOT_FOUND")

    def _set(self, client: _Client, body: bytes) -> None:
        recipe = client.inputs.get(body[0]) if body else None
        if recipe is None or len(body) != 1 + recipe.packing.size:
            return  # a real controller ignores it, too
        values = recipe.packing.unpack_from(body, 1)
        for name, value in zip(recipe.names, values, strict=True):
            self.registers[name] = value
        self.was_set.update(recipe.names)
        self.heed()


def _send_whole(connection: TcpConnection, sent: bytes, passed: bytes) -> None:
    if passed == sent:
        connection.send(sent)


def _names(text: bytes) -> list[str]:
    """Return comma-separated names; a trailing comma is permitted."""
    return [name for name in text.decode("ascii", "replace").split(",") if name]


def _recipe(names: list[str], types: list[str]) -> _Recipe | None:
    if any(kind not in FORMATS for kind in types):
        return None
    return _Recipe(names, struct.Struct(">" + "".join(FORMATS[kind] for kind in types)))


def _message(kind: int, body: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(body), kind) + body
