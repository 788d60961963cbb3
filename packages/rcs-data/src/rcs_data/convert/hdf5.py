"""HDF5 files, with h5py imported when it is needed."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Generator
from pathlib import Path
from typing import Any

from rcs_data.errors import CorruptEpisode, MissingDependency, RcsError

_MAGIC = b"\x89HDF\r\n\x1a\n"


def load_h5py() -> Any:
    """Return the package h5py.

    Raises:
        MissingDependency: It is not installed.
    """
    try:
        return importlib.import_module("h5py")
    except ImportError as err:
        raise MissingDependency("HDF5 files need h5py: pip install 'rcs-data[hdf5]'.") from err


def is_hdf5(path: Path) -> bool:
    """Return whether a file begins with the HDF5 signature."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


@contextlib.contextmanager
def reading_hdf5(path: Path) -> Generator[Any]:
    """Open a file for reading; h5py's errors about damage become one error.

    Args:
        path: The file.

    Raises:
        MissingDependency: h5py is not installed.
        CorruptEpisode: It is not an HDF5 file, or is damaged.
    """
    h5py = load_h5py()
    if not path.is_file():  # reading a pipe would never end
        raise CorruptEpisode(f"{path} is missing or not a file.")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except RcsError:
        raise
    # h5py has no errors of its own, and turns the HDF5 library's into these.
    except (OSError, RuntimeError, KeyError) as err:
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err
