"""Find an arm, a gripper, a camera or a task by name among the entry points of installed packages."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from rcs.errors import UnknownName

Kind = Literal["arm", "gripper", "hand", "camera", "tactile", "lab", "task", "agent", "operator", "policy"]


def names(kind: Kind) -> list[str]:
    """Return the names of everything of a kind that is installed; nothing is imported."""
    return sorted(_entries(kind))


def find(kind: Kind, name: str) -> Any:
    """Import and return the object that an installed package offers under a name.

    Args:
        kind: What it is; the entry-point group is `rcs.` and its plural.
        name: Name of the entry point.

    Raises:
        UnknownName: Nothing installed has the name; the message has the nearest match.
    """
    entries = _entries(kind)
    if name not in entries:
        hint = f"A package adds one through the entry-point group {_group(kind)!r}."
        raise UnknownName(kind, name, entries, hint)
    return entries[name].load()


def _group(kind: Kind) -> str:
    irregular = {"policy": "rcs.policies", "tactile": "rcs.tactiles"}
    return irregular.get(kind, f"rcs.{kind}s")


def _entries(kind: Kind) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=_group(kind))}
