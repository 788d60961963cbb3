"""How the options of commands read in their help: values are named after what they are, flags after what they do."""

from __future__ import annotations

import types
from dataclasses import is_dataclass, replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

REGISTRY = ConstructorRegistry()
"""Rules of `tyro.cli` for the fields of commands."""

_at_work: list[Any] = []


@REGISTRY.struct_rule
def _as_they_read(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return what tyro itself makes of a dataclass, with its fields described as people read them."""
    if not is_dataclass(info.type) or info.type in _at_work:
        return None
    _at_work.append(info.type)
    try:
        spec = ConstructorRegistry.get_struct_spec(info)
    finally:
        _at_work.pop()
    if not isinstance(spec, StructConstructorSpec):
        return None
    return replace(spec, fields=tuple(_as_it_reads(field) for field in spec.fields))


def _as_it_reads(field: StructFieldSpec) -> StructFieldSpec:
    kind: Any = field.type
    inner, *notes = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    has_none = any(field.default is one for one in (None, False, "", ()))
    if has_none or (get_origin(inner) is tuple and Positional in notes):
        kind = Annotated[kind, arg(help_behavior_hint="")]  # its words say what it is without a value
    if inner is bool:
        # Beside `--no-video` alone, the words of `--video` would say the opposite.
        kind = kind if field.default is True else FlagCreatePairsOff[kind]
    elif not any(getattr(note, "metavar", None) for note in notes):
        value = _value(field.name, get_args(inner)[0] if UseAppendAction in notes else inner)
        is_optional = Positional in notes and field.default in (None, "")
        kind = Annotated[kind, arg(metavar=f"[{value}]" if is_optional else value)]
    return replace(field, type=kind, helptext=lambda: _in_one_paragraph(field))


def _value(name: str, kind: Any) -> str:
    """Return what stands for a value of an option in the help."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return next((note.metavar for note in args[1:] if getattr(note, "metavar", None)), _value(name, args[0]))
    if origin in (Union, types.UnionType):
        return " | ".join(_value(name, one) for one in args if one is not type(None))
    if origin is Literal:
        return "{" + ",".join(map(str, args)) + "}"
    if origin is tuple:
        each = [_value(name.removesuffix("s"), one) for one in args if one is not ...]
        return f"[{each[0]} ...]" if ... in args else " ".join(each)
    return name.rpartition("_")[2].upper() if kind is str else getattr(kind, "__name__", name).upper()


def _in_one_paragraph(field: StructFieldSpec) -> str | None:
    text = field.helptext() if callable(field.helptext) else field.helptext
    return text and " ".join(text.split())
