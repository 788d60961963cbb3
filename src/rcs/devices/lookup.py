"""Find arms, grippers, cameras, tasks and other plugins by name or `module:Class`."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType, ModuleType
from typing import Any, Literal

from rcs.errors import InvalidSetup, UnknownName

Kind = Literal[
    "arm", "gripper", "hand", "camera", "tactile", "lab", "task", "agent", "layer", "gate", "driver", "input",
    "wire",
]  # fmt: skip
OBJECTS = ("arm", "gripper", "hand", "camera", "tactile", "lab")
"""Kinds that are objects; the others are classes."""
WORDS: Mapping[Kind, str] = {"tactile": "tactile sensor", "input": "input device"}
"""Kinds that messages call by more than the name of their group."""


def names(kind: Kind) -> list[str]:
    """Return the names of all installed plugins of a kind without importing them."""
    return sorted(_entries(kind))


def module_of(kind: Kind, given: str) -> str | None:
    """Return the name of the module of what a name stands for; None if no installed plugin of the kind has the name.

    Args:
        kind: Kind of plugin.
        given: Name of an entry point, or `module:Class`; nothing is imported.
    """
    if ":" in given:
        return given.partition(":")[0]
    entry = _entries(kind).get(given)
    return None if entry is None else entry.module


def find(kind: Kind, given: Any) -> Any:
    """Import and return the object that a name stands for.

    Args:
        kind: Kind of plugin; the entry-point group is `rcs.` and the plural of the kind.
        given: Name of an entry point, or `module:Class`; anything but a string is returned unchanged.

    Raises:
        UnknownName: No installed plugin has the name, or the module has no such class; the message has the nearest
            match.
        InvalidSetup: An installed package registers the name, but the object cannot be imported; or the module raises
            an error, or has no whole name.
    """
    if not isinstance(given, str):
        return given
    if ":" in given:
        return _import(kind, given)
    entries, word = _entries(kind), WORDS.get(kind, kind)
    if given not in entries:
        hint = f"A package registers one in the entry-point group {_group(kind)!r}; `module:Class` is valid too."
        if kind == "driver":
            hint += " A device is 'driver:address', such as 'franka:192.168.0.1'."
        raise UnknownName(word, given, entries, hint)
    entry = entries[given]
    try:
        return entry.load()
    except Exception as err:  # a module of another package may raise anything
        package = "" if entry.dist is None else f" of the package {entry.dist.name!r}"
        raise InvalidSetup(
            f"The {word} {given!r} is {entry.value!r}{package}, which cannot be imported: {type(err).__name__}: {err}. "
            "Fix or uninstall the package."
        ) from err


def name_of(kind: Kind, given: Any) -> str:
    """Return the name under which `find` finds an object: the given string, or `module:NAME`.

    Args:
        kind: Kind of plugin.
        given: A name or a class; for descriptions (arms, labs, their parts), also an object in a global variable.

    Raises:
        InvalidSetup: The object is none of these.
    """
    if isinstance(given, str):
        return given
    if isinstance(given, type):
        value = f"{given.__module__}:{given.__qualname__}"
    elif kind in OBJECTS and dataclasses.is_dataclass(given):
        value = _global_of(kind, given)
    else:
        what = "an object such as a description" if kind in OBJECTS else "a class"
        raise InvalidSetup(f"{kind} is {given!r}; valid is a name, 'module:NAME', or {what}.")
    return next((name for name, entry in _entries(kind).items() if entry.value == value), value)


def _global_of(kind: Kind, given: Any) -> str:
    """Return `module:NAME` of the global variable that is an object; a module of its own comes first."""
    own = getattr(given, "module", "")
    modules = sorted(sys.modules.items(), key=lambda item: (item[0] != own, item[0] == "__main__"))
    for module, content in modules:
        for name, value in list(getattr(content, "__dict__", {}).items()):
            if value is given:
                return f"{module}:{name}"
    raise InvalidSetup(
        f"The {kind} {getattr(given, 'name', given)!r} is in no global variable of a module, so that no other process "
        "could find it; assign it to one, such as MY_ARM = ..."
    )


def _import(kind: Kind, given: str) -> Any:
    (module, _, path), word = given.partition(":"), WORDS.get(kind, kind)
    try:
        found: Any = sys.modules.get(module) or importlib.import_module(module)
    except ImportError as err:
        raise UnknownName(word, given, _entries(kind), f"The module {module!r} cannot be imported: {err}.") from err
    except Exception as err:  # a module may raise anything, and what is no name of a module raises others
        raise InvalidSetup(
            f"The {word} {given!r} is in the module {module!r}, which cannot be imported: {type(err).__name__}: {err}. "
            "Valid is 'module:NAME' with the whole name of a module that imports."
        ) from err
    for part in path.split("."):
        if not hasattr(found, part):
            hint = "A class inside a function cannot be found by name."
            raise UnknownName(f"{word} in the module {module!r}", path, _own_names(found), hint)
        found = getattr(found, part)
    return found


def _own_names(place: Any) -> list[str]:
    """Return the public names of a module, or of a class in it, without imported names."""
    module = place.__name__ if isinstance(place, ModuleType) else place.__module__

    def is_own(value: Any) -> bool:
        if isinstance(value, type | FunctionType):
            return value.__module__ == module
        return not isinstance(value, ModuleType)

    return [name for name, value in vars(place).items() if not name.startswith("_") and is_own(value)]


def _group(kind: Kind) -> str:
    return f"rcs.{kind}s"


def _entries(kind: Kind) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=_group(kind))}
