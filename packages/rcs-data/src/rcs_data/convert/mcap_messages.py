"""The messages of an MCAP file: Foxglove's own schemas where there is one, encoded as Protocol Buffers.

Source of the fields: https://docs.foxglove.dev/docs/sdk/schemas. A file carries the description of each of its
messages, so readers need nothing else.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from rcs_data.convert.protobuf import FIXED32, FIXED64, field

COMPRESSED_IMAGE = "foxglove.CompressedImage"
RAW_IMAGE = "foxglove.RawImage"
CALIBRATION = "foxglove.CameraCalibration"
JOINTS = "foxglove.JointStates"
NUMBERS, TEXT = "rcs.Numbers", "rcs.Text"

_TIME = ".google.protobuf.Timestamp"
_JOINT = ".foxglove.JointState"
_MANY_NUMBERS = "repeated double"


def _fields(**kinds: str) -> dict[str, tuple[int, str]]:
    """Return number and type of each field, numbered from 1 in this order."""
    return {name: (number, kind) for number, (name, kind) in enumerate(kinds.items(), 1)}


_MESSAGES = {
    COMPRESSED_IMAGE: _fields(timestamp=_TIME, data="bytes", format="string", frame_id="string"),
    RAW_IMAGE: _fields(
        timestamp=_TIME,
        width="fixed32",
        height="fixed32",
        encoding="string",
        step="fixed32",
        data="bytes",
        frame_id="string",
    ),
    CALIBRATION: _fields(
        timestamp=_TIME,
        width="fixed32",
        height="fixed32",
        distortion_model="string",
        **dict.fromkeys("DKRP", _MANY_NUMBERS),
        frame_id="string",
    ),
    _JOINT[1:]: _fields(name="string", position="double"),
    JOINTS: _fields(timestamp=_TIME, joints=f"repeated {_JOINT}"),
    NUMBERS: _fields(timestamp=_TIME, values=_MANY_NUMBERS),
    TEXT: _fields(timestamp=_TIME, text="string"),
}
# Numbers of the types in a FieldDescriptorProto.
_TYPES = {"double": 1, "int64": 3, "int32": 5, "fixed32": 7, "string": 9, "message": 11, "bytes": 12}
_OPTIONAL, _REPEATED = 1, 3


def encode(schema: str, values: dict[str, Any]) -> bytes:
    """Return a message of these values by field: a time in ns since 1970, joints as a list of names and positions."""
    parts: list[bytes] = []
    for name, value in values.items():
        number, kind = _MESSAGES[schema][name]
        if kind == _TIME:
            parts.append(field(number, field(1, value // 10**9) + field(2, value % 10**9)))
        elif kind == _MANY_NUMBERS:
            parts.append(field(number, np.ascontiguousarray(value, "<f8").tobytes()))
        elif kind == "fixed32":
            parts.append(field(number, struct.pack("<I", value), FIXED32))
        elif kind == "double":
            parts.append(field(number, struct.pack("<d", value), FIXED64))
        elif kind == f"repeated {_JOINT}":
            parts += [field(number, encode(_JOINT[1:], {"name": n, "position": p})) for n, p in value]
        else:
            parts.append(field(number, value))
    return b"".join(parts)


def description(schema: str) -> bytes:
    """Return the description of a message, a `google.protobuf.FileDescriptorSet`."""
    package = schema.rpartition(".")[0]
    names = [_JOINT[1:], schema] if schema == JOINTS else [schema]
    messages = {name.rpartition(".")[2]: _MESSAGES[name] for name in names}
    time_file = "google/protobuf/timestamp.proto"
    time = {"Timestamp": {"seconds": (1, "int64"), "nanos": (2, "int32")}}
    files = (
        _file(time_file, "google.protobuf", (), time),
        _file(f"{schema.replace('.', '/')}.proto", package, (time_file,), messages),
    )
    return b"".join(field(1, file) for file in files)


def _file(name: str, package: str, needed: tuple[str, ...], messages: dict[str, dict[str, tuple[int, str]]]) -> bytes:
    """Return a FileDescriptorProto."""
    parts = [field(1, name), field(2, package), *(field(3, other) for other in needed)]
    for message, fields in messages.items():
        described = (field(2, _field(name, number, kind)) for name, (number, kind) in fields.items())
        parts.append(field(4, field(1, message) + b"".join(described)))
    return b"".join((*parts, field(12, "proto3")))


def _field(name: str, number: int, kind: str) -> bytes:
    """Return a FieldDescriptorProto."""
    word = kind.rpartition(" ")[2]
    label = _REPEATED if kind.startswith("repeated ") else _OPTIONAL
    parts = field(1, name) + field(3, number) + field(4, label) + field(5, _TYPES.get(word, _TYPES["message"]))
    return parts + field(6, word) if word.startswith(".") else parts
