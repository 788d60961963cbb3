"""HDF5 files, with h5py imported when it is needed; their arrays are checked before they are read."""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, InvalidSetup, MissingDependency, RcsError
from rcs_data.feature import Feature

_MAGIC = b"\x89HDF\r\n\x1a\n"
# A few bytes can claim any size. What is read at once [B], beyond which it must not be many times its file.
_FREE_BYTES, _MOST_GROWTH = 1 << 26, 64
# Largest piece that is compressed as a whole [B].
_MOST_CHUNK = 1 << 28


def load_h5py() -> Any:
    """Return the package h5py; MissingDependency if it is not installed."""
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


def is_numeric(values: Any) -> bool:
    """Return whether this is an array of numbers, not a group, text, or single number."""
    return getattr(values, "shape", None) is not None and values.ndim > 0 and values.dtype.kind in "fiub"


def array(group: Any, path: str, *, by_row: bool = False) -> Any:
    """Return an array of numbers that can be read row by row, and at once if it has fewer than three axes.

    Args:
        group: Where it is.
        path: Its name.
        by_row: Whether it is read row by row whatever its axes.

    Raises:
        CorruptEpisode: There is none, or it claims more than its file can hold.
    """
    values: Any = group.get(path)
    if not is_numeric(values):
        raise CorruptEpisode(f"{group.name} in {group.file.filename} has no array of numbers {path!r}.")
    item = values.dtype.itemsize
    most = max(_FREE_BYTES, _MOST_GROWTH * values.file.id.get_filesize())
    if (values.ndim < 3 and values.size * item > most) or np.prod(
        values.chunks or (1,), dtype=float
    ) * item > _MOST_CHUNK:
        raise CorruptEpisode(f"{values.name} claims {values.shape}, which is more than its file can hold.")
    return values


def checked_array(group: Any, path: str, feature: Feature, count: int) -> Any:
    """Return the array of a feature; see `array`.

    Raises:
        InvalidSetup: The group lacks it, or its rows have another shape.
        CorruptEpisode: It has another number of rows, or claims more than its file can hold.
    """
    where = f"{group.name} in {group.file.filename}"
    if path not in group:
        raise InvalidSetup(f"{where} lacks {path!r}, which other episodes have.")
    values = array(group, path)
    if len(values) != count:
        raise CorruptEpisode(f"{path} of {where} has {len(values)} rows; expected {count}.")
    if values.size != count * feature.size:
        raise InvalidSetup(f"{path} of {where} has rows of {values.shape[1:]}; other episodes have {feature.shape}.")
    return values


def by_number(names: Iterable[str]) -> dict[int, str]:
    """Return names by the numbers in which they end, "demo_10" after "demo_9"; by their places where one has none."""
    given = sorted(names)
    numbers = {int(found[0]): name for name in given if (found := re.findall(r"\d+$", name))}
    return dict(sorted(numbers.items())) if len(numbers) == len(given) else dict(enumerate(given))


def rows_of(values: Any, feature: Feature) -> Iterator[NDArray[Any]]:
    """Yield the rows of an array as values of a feature; those of images are read one by one."""
    given = values if values.ndim > 2 else values[()]
    return (np.asarray(given[i], feature.numpy_dtype).reshape(feature.shape) for i in range(len(given)))


def number_feature(key: str, values: Any) -> Feature:
    """Return the feature of an array of numbers, a row per step; InvalidSetup if it cannot be stored."""
    dtype = "float32" if values.dtype == np.float16 else values.dtype.newbyteorder("=").name
    return Feature(key=key, shape=values.shape[1:], dtype=dtype)
