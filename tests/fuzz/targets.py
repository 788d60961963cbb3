"""Targets that the fuzzer calls: everything in the extension, and the calls of worlds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rcs import _core
from rcs.sim.world import World


class Argument(NamedTuple):
    name: str
    annotation: str


class Target(NamedTuple):
    """One thing that can be called."""

    name: str
    function: Callable[..., Any]
    owner: type | None
    """The class whose instance comes first; None for functions, static methods and classes."""
    overloads: tuple[tuple[Argument, ...], ...]


def _arguments(signature: str) -> tuple[Argument, ...]:
    """Return the arguments of nanobind's signature of a function, "def f(self, x: int = \\0) -> None"."""
    parts, depth, start = [], 0, signature.index("(") + 1
    for i in range(start, len(signature)):
        if signature[i] in ",)" and depth == 0:
            parts.append(signature[start:i])
            start = i + 1
            if signature[i] == ")":
                break
        depth += (signature[i] in "([") - (signature[i] in ")]")
    pairs = [part.split("=" if ":" not in part else ":", 1) for part in parts]
    found = [Argument(pair[0].strip(), pair[1].rsplit(" = ", 1)[0].strip() if len(pair) > 1 else "") for pair in pairs]
    return tuple(a for a in found if a.name not in ("self", "cls", "*", "/", ""))


def targets_of_core() -> list[Target]:
    """Return every function, class, method and property of the extension."""
    found: list[Target] = []

    def add(name: str, function: Any, owner: type | None) -> None:
        signatures = getattr(function, "__nb_signature__", None)
        if signatures:
            found.append(Target(name, function, owner, tuple(_arguments(s[0]) for s in signatures)))

    for name, value in vars(_core).items():
        if not isinstance(value, type):
            add(name, value, None)
            continue
        for member, raw in vars(value).items():
            full = f"{name}.{member}"
            if member == "__init__":
                signatures = getattr(raw, "__nb_signature__", ())
                found.append(Target(name, value, None, tuple(_arguments(s[0]) for s in signatures)))
            elif isinstance(raw, property):
                found.append(Target(full, lambda self, m=member: getattr(self, m), value, ((),)))
            else:
                is_static = type(raw).__name__ in ("nb_func", "staticmethod")
                add(full, getattr(value, member), None if is_static else value)
    return found


PYTHON_WORLD = {
    "advance": ("copies",),
    "reset": ("copies",),
    "refresh": ("copies",),
    "update_constants": ("copies",),
    "vary": ("field",),
    "field": ("field",),
    "geom_flags": ("names",),
    "subtree_flags": ("body",),
    "states": (),
}


def targets_of_python() -> list[Target]:
    """Return the calls of worlds and environments in Python."""
    worlds = [
        Target(f"sim.World.{name}", getattr(World, name), World, (tuple(Argument(a, "") for a in arguments),))
        for name, arguments in PYTHON_WORLD.items()
    ]
    arguments = ("model", "data", "copies", "threads", "frequency", "stepping", "max_substeps")
    return [*worlds, Target("sim.World", World, None, (tuple(Argument(a, "") for a in arguments),))]
