"""Frozen records whose fields are checked by msgspec, both when they are made and when they are read."""

from __future__ import annotations

import functools
import re
import threading
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, TypeVar, get_type_hints

import msgspec
from msgspec import Meta

from vlagents.errors import InvalidInput

T = TypeVar("T")

Name = Annotated[str, Meta(min_length=1, max_length=200)]
Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Hertz = Annotated[float, Meta(ge=0.0, le=1e9)]
Seconds = Annotated[float, Meta(gt=0.0, le=1e9)]


_preparing = threading.Lock()


class Record:
    """The parent of frozen dataclasses whose fields are checked against their annotations."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: A field has the wrong type or is out of range.
        """
        cls: Any = type(self)
        try:
            msgspec.convert({name: getattr(self, name) for name in cls.__dataclass_fields__}, _fields_of(cls))
        except msgspec.ValidationError as error:
            field = (re.findall(r"`\$\.(\w+)", str(error)) or [""])[0]
            value = getattr(self, field, None)
            raise InvalidInput(f"{field} of {cls.__name__} is {value!r:.80}. {error}.") from error

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON and msgpack take them."""
        return asdict(self)  # type: ignore[call-overload]

    @classmethod
    def from_dict(cls: type[T], values: object) -> T:
        """Read what `to_dict` made; unknown names are ignored.

        Raises:
            InvalidInput: A value is missing or wrong.
        """
        return read(cls, values)


def read(cls: type[T], values: object) -> T:
    """Return a dataclass made of plain values, as JSON and msgpack have them; unknown names are ignored.

    Raises:
        InvalidInput: A value is missing or wrong.
    """
    _prepare(cls)
    try:
        return msgspec.convert(values, cls)
    except msgspec.ValidationError as error:
        name = cls.__name__.lstrip("_")
        raise InvalidInput(f"{name} cannot be read from {_shown(values)}: {error}.") from error


def positive(name: str, value: object) -> float:
    """Return a number of seconds if it is finite and above 0.

    Raises:
        InvalidInput: It is not.
    """
    try:
        return msgspec.convert(value, Seconds)
    except msgspec.ValidationError as error:
        raise InvalidInput(f"{name} is {value!r:.80}; valid is a number of seconds above 0.") from error


def _shown(values: object) -> str:
    return f"a dictionary of {', '.join(map(str, values))}"[:200] if isinstance(values, Mapping) else f"{values!r:.80}"


@functools.cache
def _fields_of(cls: type) -> type[msgspec.Struct]:
    """Return a class with the same fields, whose conversion does not call `__post_init__` again."""
    hints = get_type_hints(cls, include_extras=True)
    fields = msgspec.defstruct(cls.__name__, [(name, hints[name]) for name in cls.__dataclass_fields__])
    _prepare(fields)
    return fields


@functools.cache
def _prepare(cls: type) -> None:
    """Have msgspec take a type apart, which ends the process where two threads do it at once."""
    with _preparing:
        msgspec.json.Decoder(cls)
