"""HDF5 files, with h5py imported when it is needed."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Generator, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.observations import kept_dtype
from rcs_data.errors import CorruptEpisode, InvalidSetup, RcsError, package_of
from rcs_data.files.feature import Feature

_MAGIC = b"\x89HDF\r\n\x1a\n"


load_h5py = partial(package_of, "h5py", "hdf5", "HDF5 files need h5py")
"""Returns the package h5py; MissingDependency if it is not installed."""


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


def array(group: Any, path: str) -> Any:
    """Return an array of numbers; CorruptEpisode if there is none of that name."""
    values: Any = group.get(path)
    if not is_numeric(values):
        raise CorruptEpisode(f"{group.name} in {group.file.filename} has no array of numbers {path!r}.")
    return values


def checked_array(group: Any, path: str, feature: Feature, count: int) -> Any:
    """Return the array of a feature.

    Raises:
        InvalidSetup: The group lacks it, or its rows have another shape.
        CorruptEpisode: It has another number of rows.
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
    dtype = values.dtype.newbyteorder("=").name
    return Feature(key=key, shape=values.shape[1:], dtype=kept_dtype(dtype) or dtype)
