"""HDF5 files: the package that reads and writes them, loaded when it is needed."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from rcs.errors import MissingDependency

_MAGIC = b"\x89HDF\r\n\x1a\n"


def load_h5py() -> Any:
    """Return the package h5py.

    Raises:
        MissingDependency: It is not installed.
    """
    try:
        return importlib.import_module("h5py")
    except ImportError as err:
        raise MissingDependency("HDF5 files need h5py: pip install 'robot-control-stack[hdf5]'.") from err


def is_hdf5(path: Path) -> bool:
    """Return whether a file begins as HDF5 does."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC
