"""The package of the extra `policy`, imported when it is first used."""

from __future__ import annotations

import importlib
from typing import Any

from rcs.errors import MissingDependency


def vlagents(module: str = "vlagents") -> Any:
    """Import and return `vlagents`, or a module of it.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as err:
        raise MissingDependency(
            f"Policies at an address need {module.partition('.')[0]}: pip install 'robot-control-stack[policy]'."
        ) from err
