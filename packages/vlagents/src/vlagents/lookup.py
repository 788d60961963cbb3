"""Policies and simulators by name, with their options as text."""

from __future__ import annotations

import difflib
import inspect
import json
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from vlagents.errors import InvalidInput


def unknown(what: str, name: str, known: Sequence[str]) -> InvalidInput:
    """Return the error about an unknown name, which lists the known ones."""
    near = difflib.get_close_matches(name, known, 1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return InvalidInput(f"There is no {what} {name!r}; there are {', '.join(known) or 'none'}.{hint}")


def find(what: str, place: str, valid: str = "module:Class") -> Callable[..., Any]:
    """Return the class or function of `module:name`.

    Args:
        what: A word for its kind, for the error.
        place: The module and the name.
        valid: The form of names of this kind, for the error.

    Raises:
        InvalidInput: There is none.
    """
    try:
        return pkgutil.resolve_name(place)
    except (ImportError, AttributeError, ValueError) as error:
        raise InvalidInput(f"There is no {what} {place!r}; valid is {valid}. {error}.") from error


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
        valid = ", ".join(f"--{option}" for option in list(known)[len(first) :]) or "none"
        raise InvalidInput(f"The {what} {name!r} has no option --{wrong[0]}; valid: {valid}.")
    given = {option: _value(text, known[option].annotation) for option, text in options.items()} | more
    try:
        signature.bind(*first, **given)
    except TypeError as error:
        raise InvalidInput(f"The {what} {name!r} cannot be made: {error}.") from error
    return partial(make, *first, **given)


def _value(text: str, annotation: object) -> Any:
    if annotation in (str, "str"):
        return text
    try:
        return json.loads(text)
    except ValueError:
        return text
