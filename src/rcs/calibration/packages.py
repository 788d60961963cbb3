"""The packages of the extra `calibration`, imported when they are first used."""

from __future__ import annotations

import importlib
from typing import Any

from rcs.errors import MissingDependency


def package(name: str) -> Any:
    """Import and return a package of the extra `calibration`, or a module of it.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError as err:
        raise MissingDependency(
            f"Calibration needs {name.partition('.')[0]}: pip install 'robot-control-stack[calibration]'."
        ) from err
