"""Policies and simulators by name, with their options as text."""

from __future__ import annotations

import difflib
import importlib
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from vlagents.errors import InvalidInput


def unknown(what: str, name: str, known: Sequence[str]) -> InvalidInput:
    """Return the error about an unknown name, which lists the known ones."""
    return InvalidInput(f"There is no {what} {name!r}; there are {', '.join(known) or 'none'}.{_hint(name, known)}")


def find(what: str, place: str, valid: str = "module:Class") -> Callable[..., Any]:
    """Return the class or function of `module:name`.

    Args:
        what: A word for its kind, for the error.
        place: The module and the name.
        valid: The form of names of this kind, for the error.

    Raises:
        InvalidInput: There is none.
    """
    module, _, own = place.partition(":")
    try:
        found = getattr(importlib.import_module(module), own)
    except (ImportError, AttributeError, ValueError) as error:
        raise InvalidInput(f"There is no {what} {place!r}; valid is {valid}. {error}.") from error
    if not callable(found):
        raise InvalidInput(f"The {what} {place!r} is {type(found).__name__}; valid is {valid}.")
    return found


def prepared(
    what: str, name: str, make: Callable[..., Any], first: Sequence[str], options: Mapping[str, str], **more: Any
) -> Callable[[], Any]:
    """Return a call without arguments that makes something.

    Args:
        what: A word for its kind, for errors.
        name: Its name, for errors.
        make: A class or function.
        first: The first arguments.
        options: More arguments by name, as JSON, or as text where they are no JSON or are annotated `str`.
        more: More arguments by name, as they are.

    Raises:
        InvalidInput: It does not take such arguments; the message lists its options.
    """
    signature = inspect.signature(make)
    known = signature.parameters
    if wrong := [option for option in (*options, *more) if option not in known]:
        valid = [f"--{option}" for option in list(known)[len(first) :]]
        hint = _hint(f"--{wrong[0]}", valid)
        raise InvalidInput(
            f"The {what} {name!r} has no option --{wrong[0]}; valid: {', '.join(valid) or 'none'}.{hint}"
        )
    given = {option: _value(text, known[option].annotation) for option, text in options.items()} | more
    try:
        signature.bind(*first, **given)
    except TypeError as error:
        raise InvalidInput(f"The {what} {name!r} cannot be made: {error}.") from error
    return partial(make, *first, **given)


def _hint(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f" Did you mean {near[0]!r}?" if near else ""


def _value(text: str, annotation: object) -> Any:
    if annotation in (str, "str"):
        return text
    try:
        return json.loads(text)
    except ValueError:
        return text
