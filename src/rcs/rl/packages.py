"""The packages of the extra `rl`, imported when they are first used."""

from __future__ import annotations

from typing import Any

from rcs.extras import package_of


def package(name: str) -> Any:
    """Import and return a package of the extra `rl`, or a module of it.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    return package_of("rl", name, "Training, and running what was trained, need")
