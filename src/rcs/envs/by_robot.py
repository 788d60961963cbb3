"""The one place that knows how values of robots are keyed: flat for a single robot, under their names for several."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def by_robot(names: Iterable[str], value: Any) -> dict[str, Any]:
    """Return the parts of an observation, an action or a space of an environment, by the names of its robots."""
    known = list(names)
    return {known[0]: value} if len(known) == 1 else {name: value[name] for name in known}


def joined(parts: Mapping[str, Any]) -> Any:
    """Return the parts by name as an environment has them; the inverse of `by_robot`."""
    return next(iter(parts.values())) if len(parts) == 1 else dict(parts)


def prefixes(names: Iterable[str]) -> dict[str, str]:
    """Return what stands before the keys of each robot in a dataset: nothing for a single one."""
    known = list(names)
    return {known[0]: ""} if len(known) == 1 else {name: f"{name}/" for name in known}
