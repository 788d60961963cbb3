"""Frozen records of options: every field is checked by its type and bounds, written as JSON and read back.

Types and bounds are those of msgspec; messages say the value, what is valid, and the nearest name.

Examples:
    >>> class Learner(Record):
    ...     steps: Whole = 64
    ...     schedule: Literal["constant", "linear"] = "linear"
    >>> Learner.from_json(Learner(steps=8).to_json())
    Learner(steps=8, schedule='linear')
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import re
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import numpy as np
from msgspec import Meta as Meta
from typing_extensions import Self, dataclass_transform

from rcs_data.errors import InvalidSetup, UnknownName

Given = TypeVar("Given")
Kept = TypeVar("Kept")

Whole = Annotated[int, Meta(ge=1)]
"""A whole number from 1."""
Natural = Annotated[int, Meta(ge=0)]
"""A whole number from 0."""
Positive = Annotated[float, Meta(gt=0)]
"""A finite number above 0."""
NotNegative = Annotated[float, Meta(ge=0)]
"""A finite number from 0."""
Share = Annotated[float, Meta(ge=0, le=1)]
"""A number from 0 to 1."""
_NUMPY = (np.generic, np.ndarray)
INFINITE = "infinite"
"""Allows infinity: `Annotated[float, Meta(gt=0), INFINITE]`. Other fields refuse it, and all refuse NaN."""


def converted(
    *,
    converter: Callable[[Given], Kept],
    default: Any = dataclasses.MISSING,
    default_factory: Any = dataclasses.MISSING,
    kw_only: bool = True,
) -> Any:
    """Declare a field of a record that takes more than it keeps, such as one number for a width and a height.

    Args:
        converter: Returns what is kept; called with what is given, before it is checked. It returns what it does not
            know as it is.
        default: The default, as given.
        default_factory: Makes the default, as given.
        kw_only: Whether it is given by name alone.
    """
    own: Any = dataclasses.field(  # pyright: ignore[reportCallIssue]  one of the defaults is MISSING
        default=default, default_factory=default_factory, kw_only=kw_only, metadata={"converter": converter}
    )
    return own


def require_whole(name: str, value: Any, least: int | None = 0, most: int | None = None) -> int:
    """Check a number that is no field of a record, and return it as one of Python.

    Args:
        name: Its name, for the message.
        value: The number, of Python or NumPy.
        least: Smallest valid one; None for no bound.
        most: Largest valid one; None for no bound.

    Raises:
        InvalidSetup: It is no whole number, or out of bounds.
    """
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or (least is not None and value < least) or (most is not None and value > most):
        bounds = ("" if least is None else f" from {least}") + ("" if most is None else f" to {most}")
        raise InvalidSetup(f"{name} is {value!r:.80}; valid is a whole number{bounds}.")
    return int(value)


def require_number(name: str, value: Any) -> float:
    """Check a number as `require_whole` does that may have a fraction; a whole one is returned as int.

    Raises:
        InvalidSetup: It is no number.
    """
    if isinstance(value, float | np.floating):
        return float(value)
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return int(value)
    raise InvalidSetup(f"{name} is {value!r:.80}; valid is a number.")


def accepted(own: dataclasses.Field[Any]) -> str:
    """Return the annotation of what a field of a record takes."""
    annotations = getattr(own.metadata.get("converter"), "__annotations__", {})
    return str(next((hint for name, hint in annotations.items() if name != "return"), own.type))


@dataclass_transform(
    frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field, dataclasses.Field, converted)
)
class Record:
    """The parent of records of options. A subclass is a frozen dataclass with keyword arguments, without a decorator.

    Sequences become tuples, mappings dictionaries, and numbers of NumPy those of Python. Numbers are finite unless the
    field is marked with `INFINITE`. A subclass that checks more extends `__post_init__`.
    """

    hints: ClassVar[Mapping[str, str]] = {}
    """Hints on what to do instead, in a sentence: by an option that does not exist, such as `fps`, or by an option and
    a wrong value, such as `control=pose`."""

    def __init_subclass__(cls, *, kw_only: bool = True) -> None:
        """Make the subclass a frozen dataclass.

        Args:
            kw_only: Whether its own fields are given by name alone.
        """
        super().__init_subclass__()
        dataclasses.dataclass(frozen=True, kw_only=kw_only)(cls)
        cls.__hash__ = Record.__hash__  # a dataclass's own one knows no mappings

    def __hash__(self) -> int:
        """Return the same number for equal records."""
        return hash((type(self), *(_hashable(getattr(self, own.name)) for own in _fields(type(self)))))

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has an invalid value; the message says what is valid.
        """
        kinds = _kinds(type(self))
        for own in _fields(type(self)):
            value = self._checked(own, getattr(self, own.name), *kinds[own.name])
            object.__setattr__(self, own.name, value)

    def _checked(self, own: dataclasses.Field[Any], value: Any, kind: Any, fit: Callable[[Any], Any]) -> Any:
        name, convert = own.name, own.metadata.get("converter")
        try:
            return fit(value if convert is None else convert(value))
        except InvalidSetup as err:  # of a record inside, or of a converter
            raise InvalidSetup(f"{name}: {err}") from err
        except msgspec.ValidationError as err:
            hint = self.hints.get(f"{name}={value}", "") or _nearest(value, kind)
            given = repr(value) if len(repr(value)) <= 300 else f"{repr(value)[:300]}…"
            raise InvalidSetup(f"{name} is {given}; valid: {valid_values(kind)}.{hint and ' '}{hint}") from err

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {own.name: as_json(getattr(self, own.name)) for own in _fields(type(self))}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return the record that `to_json` wrote.

        Raises:
            InvalidSetup: A key is unknown or a value is invalid.
        """
        if not isinstance(values, Mapping):  # pyright: ignore[reportUnnecessaryIsInstance]  files have anything
            raise InvalidSetup(f"{cls.__name__} is {values!r}; valid is a mapping of its fields by name.")
        names = [own.name for own in _fields(cls) if own.init]
        for key in values:
            if key not in names:
                hint = cls.hints.get(str(key), "")
                if hint:
                    raise InvalidSetup(f"{cls.__name__} has no option {key!r}. {hint}")
                raise InvalidSetup(UnknownName(f"option of {cls.__name__}", str(key), names).message)
        for own in _fields(cls):
            is_needed = own.init and own.default is own.default_factory is dataclasses.MISSING
            if is_needed and own.name not in values:
                raise InvalidSetup(f"{cls.__name__} lacks {own.name!r}.")
        return cls(**values)


@cache
def _fields(record: Any) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(record)


def _hashable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return frozenset((key, _hashable(one)) for key, one in value.items())
    return tuple(map(_hashable, value)) if isinstance(value, list | tuple) else value


@cache
def _kinds(record: type[Record]) -> dict[str, tuple[Any, Callable[[Any], Any]]]:
    """Return the type of each field, and what fits a value to it."""
    parents = reversed(record.__mro__)
    hints = {name: kind for one in parents for name, kind in inspect.get_annotations(one, eval_str=True).items()}
    return {own.name: (hints[own.name], _fitter(hints[own.name])) for own in _fields(record)}


def _fitter(kind: Any) -> Callable[[Any], Any]:
    """Return a function that returns a value in the form that a type has, or raises `msgspec.ValidationError`.

    msgspec converts what has no parts. Unions are taken apart here, because msgspec 0.22 crashes on one of a number
    with bounds and a tuple of fixed length. Texts and None are most of what files have, and are looked up first.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        fit = partial(_fit_any, [*map(_fitter, parts)])
    elif isinstance(kind, type) and issubclass(kind, Record):
        fit = partial(_fit_record, kind)
    elif origin is tuple:
        fit = partial(_fit_tuple, [_fitter(part) for part in parts if part is not ...], ... in parts)
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        fit = partial(_fit_mapping, *map(_fitter, parts))
    else:
        fit = partial(_fit_plain, kind, INFINITE in parts)
    names = {part for part in parts if type(part) is str} if origin is Literal else set[str]()
    has_none = type(None) in parts

    def fitted(value: Any) -> Any:
        if (value is None and has_none) or (type(value) is str and (kind is str or value in names)):
            return value
        return fit(value.tolist() if isinstance(value, _NUMPY) else value)

    return fitted


def _fit_any(fits: Sequence[Callable[[Any], Any]], value: Any) -> Any:
    reasons: list[Exception] = []
    for fit in fits:
        try:
            return fit(value)
        except (msgspec.ValidationError, InvalidSetup) as err:
            reasons.append(err)
    raise next((err for err in reasons if isinstance(err, InvalidSetup)), reasons[0])


def _fit_record(kind: type[Record], value: Any) -> Any:
    return value if isinstance(value, kind) else kind.from_json(msgspec.convert(value, dict[str, Any]))


def _fit_tuple(fits: list[Callable[[Any], Any]], has_any_length: bool, value: Any) -> Any:
    items = msgspec.convert(value, tuple[Any, ...])
    fits = fits * len(items) if has_any_length else fits
    if len(items) != len(fits):
        raise msgspec.ValidationError(f"Expected {len(fits)} items, got {len(items)}")
    return tuple(fit(item) for fit, item in zip(fits, items, strict=True))


def _fit_mapping(fit_key: Callable[[Any], Any], fit_value: Callable[[Any], Any], value: Any) -> Any:
    return {fit_key(key): fit_value(one) for key, one in msgspec.convert(value, dict[Any, Any]).items()}


def _fit_plain(kind: Any, is_infinite: bool, value: Any) -> Any:
    found = msgspec.convert(value, kind)
    if isinstance(found, float) and not math.isfinite(found) and (math.isnan(found) or not is_infinite):
        raise msgspec.ValidationError("Expected a finite number")
    return found


def valid_values(kind: Any) -> str:
    """Return in words what a type with bounds allows."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        bounds = [words for one in parts[1:] if isinstance(one, Meta) for words in _bounds(one)]
        what = valid_values(parts[0]).replace("finite ", "") if INFINITE in parts else valid_values(parts[0])
        return re.sub(r"(from \S+) and up to", r"\1 to", " ".join([what, " and ".join(bounds)]).rstrip())
    if origin in (Union, types.UnionType):
        return ", or ".join(map(valid_values, parts))
    if origin is Literal:
        return ", ".join(map(repr, parts))
    if origin is tuple:
        kinds = [part for part in parts if part is not ...]
        count = "" if parts[-1] is ... else f" of {len(kinds)}"
        is_same = all(part == kinds[0] for part in kinds)
        each = f"each {valid_values(kinds[0])}" if is_same else "; ".join(map(valid_values, kinds))
        return f"a sequence{count}, {each}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"a mapping ({valid_values(parts[0])}: {valid_values(parts[1])})"
    return _WORDS.get(kind) or f"an object of {getattr(origin or kind, '__name__', kind)}"


_WORDS: dict[Any, str] = {
    bool: "True, False",
    int: "a whole number",
    float: "a finite number",
    str: "a text",
    type(None): "None",
    Any: "anything",
}


def _bounds(meta: Meta) -> list[str]:
    bounds = {"above": meta.gt, "from": meta.ge, "below": meta.lt, "up to": meta.le, "of at least": meta.min_length}
    return [f"{word} {bound:g}" for word, bound in bounds.items() if bound is not None]


def _nearest(value: Any, kind: Any) -> str:
    """Return a sentence on the nearest valid name, or on names that are given as one text."""
    if not isinstance(value, str):
        return ""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType, Annotated):
        return next(filter(None, (_nearest(value, part) for part in parts)), "")
    if origin is tuple:
        return f"Give a sequence, such as ({value!r},)."
    names = [str(part) for part in parts] if origin is Literal else []
    near = difflib.get_close_matches(value.lower(), names, n=1, cutoff=0.5)
    return f"Did you mean {near[0]!r}?" if near else ""


def as_json(value: Any) -> Any:
    """Return a value of a record as JSON values: records as dictionaries, sequences as lists."""
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, Mapping):
        return {key: as_json(one) for key, one in value.items()}
    return [as_json(one) for one in value] if isinstance(value, tuple | list) else value
