"""Packages of the extras, imported when they are first used."""

from __future__ import annotations

import importlib
from typing import Any

from rcs.errors import MissingDependency


def package_of(extra: str, name: str, purpose: str = "This needs") -> Any:
    """Import and return a package of an extra, or a module of it.

    Args:
        extra: The extra, such as "rl".
        name: The package or module.
        purpose: The part that needs it, as the subject of a sentence with its verb.

    Raises:
        MissingDependency: It is not installed, or does not load; the message names the extra, or what is missing.
    """
    package = name.partition(".")[0]
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as err:
        raise MissingDependency(f"{purpose} {package}: pip install 'robot-control-stack[{extra}]'.") from err
    except ImportError as err:
        raise MissingDependency(
            f"{purpose} {package}, which is installed but does not load: {err}. Install the system's package that has "
            "what it lacks."
        ) from err
