"""Pickles without running any: they are written as opcodes, and read as a description of what they would have made.

LeRobot's wire carries pickles. To unpickle is to import and call whatever the sender names; here nothing is imported or
called, for there is nothing here that could. Names stay names (`Name`), calls stay calls (`Call`), and whoever reads
takes out the numbers that it knows. Opcodes and calls that a chunk of tensors does not need are refused.
"""

from __future__ import annotations

import io
import pickletools
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import BadMessage, InvalidInput

MOST_OPCODES = 2_000_000
"""Most opcodes of one pickle; a chunk of a thousand actions has some fifty thousand."""
STORAGES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "BFloat16Storage": "<u2"}
"""What torch calls numbers in memory, and their dtypes; of bfloat16, the upper half of a float32."""
_LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
"""First number of what `torch.save` wrote before it wrote archives, and still writes inside pickles."""
_MARK = object()


@dataclass(frozen=True)
class Name:
    """The name of a class or a function, which is not looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        """Return it as Python writes it."""
        return f"{self.module}.{self.name}"


@dataclass
class Call:
    """A call that was asked for, and is not made; an object is the call of its class, with a state."""

    function: Name
    arguments: tuple[Any, ...]
    state: Any = None


# --- Writing ----------------------------------------------------------------------------------------------------------


def write(value: Any) -> bytes:
    """Return a pickle (protocol 5) of plain values, arrays, and objects as `Call`s.

    Args:
        value: None, a bool, int, float or str; a list, tuple or dictionary of such; an array of numbers; a `Call`
            without arguments, whose state becomes the fields of the object.

    Raises:
        InvalidInput: There is something else in it.
    """
    parts = [b"\x80\x05"]
    _write(value, parts)
    return b"".join([*parts, b"."])


def _write(value: Any, parts: list[bytes]) -> None:
    if value is None or isinstance(value, bool):
        parts.append({None: b"N", True: b"\x88", False: b"\x89"}[value])
    elif isinstance(value, int):
        data = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
        parts.append(b"\x8b" + struct.pack("<I", len(data)) + data)
    elif isinstance(value, float):
        parts.append(b"G" + struct.pack(">d", value))
    elif isinstance(value, str):
        data = value.encode()
        parts.append(b"X" + struct.pack("<I", len(data)) + data)
    elif isinstance(value, (list, tuple)):
        parts.append(b"(")
        for one in value:
            _write(one, parts)
        parts.append(b"t" if isinstance(value, tuple) else b"l")
    elif isinstance(value, Mapping):
        parts.append(b"(")
        for key, one in value.items():
            _write(key, parts)
            _write(one, parts)
        parts.append(b"d")
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        _write_array(value, parts)
    elif isinstance(value, Call) and not value.arguments:
        parts.append(f"c{value.function.module}\n{value.function.name}\n)\x81".encode("latin-1"))
        _write(value.state, parts)
        parts.append(b"b")
    else:
        raise InvalidInput(f"A {type(value).__name__} does not travel over this wire.")


def _write_array(array: NDArray[Any], parts: list[bytes]) -> None:
    """Write `numpy.ndarray(shape, dtype, bytearray)`, which every NumPy knows under this name."""
    parts.append(b"cnumpy\nndarray\n(")
    _write(tuple(array.shape), parts)
    _write(array.dtype.newbyteorder("<").str, parts)
    data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
    parts += [b"\x96" + struct.pack("<Q", len(data)), data, b"tR"]


# --- Reading ----------------------------------------------------------------------------------------------------------


def read(data: bytes) -> Any:
    """Return what a pickle describes: plain values, and `Call`s and `Name`s in the place of objects.

    Raises:
        BadMessage: It is no pickle, or has something that no chunk of actions needs.
    """
    return _read(io.BytesIO(data))


def _read(stream: io.BytesIO) -> Any:
    machine = _Machine()
    try:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(stream)):
            if count >= MOST_OPCODES:
                raise BadMessage(f"A pickle has more than {MOST_OPCODES} opcodes.")
            if opcode.name == "STOP":
                return machine.top()
            machine.act(opcode.name, argument)
    except BadMessage:
        raise
    except Exception as error:  # whatever is raised for what is no pickle
        raise BadMessage(f"This is no pickle of plain values: {type(error).__name__}: {error}.") from error
    raise BadMessage("A pickle has no end.")


class _Machine:
    """The stack on which a pickle describes a value. It makes lists, dictionaries and tuples, and nothing else."""

    def __init__(self) -> None:
        self._stack: list[Any] = []
        self._memory: dict[int, Any] = {}

    def top(self) -> Any:
        """Return the value on the stack."""
        if not self._stack or self._stack[-1] is _MARK:
            raise BadMessage("A pickle ends with nothing on its stack.")
        return self._stack[-1]

    def act(self, name: str, argument: Any) -> None:
        """Do what an opcode says, if it only describes.

        Raises:
            BadMessage: It does more, or the stack does not have what it needs.
        """
        stack = self._stack
        if name in ("PROTO", "FRAME"):
            return
        if name in _LITERALS:
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append({"NONE": None, "NEWTRUE": True, "NEWFALSE": False}[name])
        elif name in ("EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE"):
            stack.append({"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}[name]())
        elif name == "MARK":
            stack.append(_MARK)
        elif name in ("MEMOIZE", "BINPUT", "LONG_BINPUT"):
            self._memory[len(self._memory) if name == "MEMOIZE" else argument] = self.top()
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(self._memory[argument])
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            stack.append(tuple(self._pop(int(name[-1]))))
        elif name == "TUPLE":
            stack.append(tuple(self._since_mark()))
        elif name in ("APPEND", "APPENDS"):
            found = self._pop(1) if name == "APPEND" else self._since_mark()
            self._top_of(list).extend(found)
        elif name in ("SETITEM", "SETITEMS"):
            found = self._pop(2) if name == "SETITEM" else self._since_mark()
            if not all(isinstance(key, str) for key in found[::2]) or len(found) % 2:
                raise BadMessage("A dictionary of a pickle has keys that are no text.")
            self._top_of(dict).update(zip(found[::2], found[1::2], strict=True))
        else:
            self._describe(name, argument)

    def _describe(self, name: str, argument: Any) -> None:
        """Put the description of a name, a call, or an object on the stack."""
        stack = self._stack
        if name == "GLOBAL":
            stack.append(Name(*argument.split(" ", 1)))
        elif name == "STACK_GLOBAL":
            module, function = self._pop(2)
            stack.append(Name(str(module), str(function)))
        elif name in ("REDUCE", "NEWOBJ"):
            function, arguments = self._pop(2)
            if not isinstance(function, Name) or function not in CALLS or not isinstance(arguments, tuple):
                raise BadMessage(f"A pickle wants to call {function!s:.80}; valid: {', '.join(map(str, CALLS))}.")
            stack.append(Call(function, arguments))
        elif name == "BUILD":
            (state,) = self._pop(1)
            self._top_of(Call).state = state
        elif name == "BINPERSID":
            stack.append(Call(_PERSISTENT, tuple(self._pop(1))))
        else:
            raise BadMessage(f"A pickle has the opcode {name}, which no chunk of actions needs.")

    def _pop(self, count: int) -> list[Any]:
        found = [self._stack.pop() for _ in range(count)][::-1]
        if any(one is _MARK for one in found):
            raise BadMessage("A pickle takes a mark for a value.")
        return found

    def _since_mark(self) -> list[Any]:
        found: list[Any] = []
        while (one := self._stack.pop()) is not _MARK:
            found.append(one)
        return found[::-1]

    def _top_of(self, kind: type) -> Any:
        found = self.top()
        if not isinstance(found, kind):
            raise BadMessage(f"A pickle changes a {type(found).__name__} as if it were another thing.")
        return found


_LITERALS = frozenset(
    ["BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "SHORT_BINUNICODE", "BINUNICODE"]
    + ["SHORT_BINBYTES", "BINBYTES", "BINBYTES8"]
)
_CONSTANTS = frozenset(["NONE", "NEWTRUE", "NEWFALSE"])
_PERSISTENT = Name("torch", "storage")
TIMED_ACTION = Name("lerobot.async_inference.helpers", "TimedAction")
TENSOR = Name("torch._utils", "_rebuild_tensor_v2")
STORAGE = Name("torch.storage", "_load_from_bytes")
CALLS = (TIMED_ACTION, TENSOR, STORAGE, Name("collections", "OrderedDict"))
"""What a chunk of actions describes by a call: an action, its tensor, the tensor's numbers, and its empty hooks."""


# --- Tensors ----------------------------------------------------------------------------------------------------------


def numbers(tensor: Any) -> NDArray[np.float64]:
    """Return the numbers of a tensor that `read` has described.

    Raises:
        BadMessage: It is no tensor, or lies outside its memory.
    """
    if not isinstance(tensor, Call) or tensor.function != TENSOR or len(tensor.arguments) < 4:
        raise BadMessage("An action of the answer is no tensor.")
    storage, offset, shape, strides = tensor.arguments[:4]
    if not isinstance(storage, Call) or storage.function != STORAGE or len(storage.arguments) != 1:
        raise BadMessage("A tensor of the answer has no memory.")
    is_shaped = isinstance(shape, tuple) and isinstance(strides, tuple) and len(shape) == len(strides) <= 4
    if not is_shaped or not all(type(n) is int and 0 <= n < 1 << 31 for n in (offset, *shape, *strides)):
        raise BadMessage(f"A tensor of the answer has the shape {shape!r:.80} and the strides {strides!r:.80}.")
    memory = _memory(storage.arguments[0])
    last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
    if 0 in shape or last >= len(memory) or np.prod(shape, dtype=float) > len(memory):
        raise BadMessage(f"A tensor of shape {shape} lies outside its memory of {len(memory)} numbers.")
    steps = tuple(stride * memory.itemsize for stride in strides)
    return np.array(np.lib.stride_tricks.as_strided(memory[offset:], shape, steps), np.float64)


def _memory(data: Any) -> NDArray[Any]:
    """Return the numbers that torch wrote: four pickles, their size, and their bytes."""
    if not isinstance(data, bytes):
        raise BadMessage("A tensor of the answer has no memory.")
    stream = io.BytesIO(data)
    magic, _, system, described, keys = (_read(stream) for _ in range(5))
    if magic != _LEGACY_MAGIC or not isinstance(system, dict) or not isinstance(keys, list) or len(keys) != 1:
        raise BadMessage("The memory of a tensor is not as torch writes it.")
    about = described.arguments[0] if isinstance(described, Call) and described.arguments else None
    if not isinstance(about, tuple) or len(about) < 5 or not isinstance(about[1], Name):
        raise BadMessage("The memory of a tensor is not as torch writes it.")
    kind, rest = about[1], stream.read()
    if kind.module != "torch" or kind.name not in STORAGES or system.get("little_endian") is not True:
        raise BadMessage(f"A tensor is of {kind}; valid: {', '.join(STORAGES)} of torch, little-endian.")
    dtype = np.dtype(STORAGES[kind.name])
    count = struct.unpack("<q", rest[:8])[0] if len(rest) >= 8 else -1
    if count < 0 or len(rest) != 8 + count * dtype.itemsize:
        raise BadMessage(f"The memory of a tensor has {len(rest) - 8} bytes; it announced {count} numbers.")
    found = np.frombuffer(rest, dtype, offset=8)
    return (found.astype("<u4") << 16).view("<f4") if kind.name == "BFloat16Storage" else found
