"""Results that travel with files: a worker on another machine writes into its own folder and sends what it wrote."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data.durable import remove_tree, write_file
from rcs_data.output import temporary_folder

from rcs.rollout.pool import Worker

FOLDER = "rcs-worker"
"""In the name of a worker's own folder, which lies in that for temporary files."""


@dataclass(frozen=True, kw_only=True)
class Parcel:
    """A result, and the files that were written for it."""

    result: Any
    files: Mapping[str, NDArray[np.uint8]]
    """Contents by path relative to the worker's folder, with `/`. As arrays they reach another process uncopied."""

    def by_folder(self) -> dict[str, dict[str, memoryview]]:
        """Return the contents of files by the folder they are in, then by name."""
        found: dict[str, dict[str, memoryview]] = {}
        for path, data in self.files.items():
            folder, _, name = path.rpartition("/")
            found.setdefault(folder, {})[name] = data.data
        return found

    def unpack(self, out: Path) -> None:
        """Write the files into a folder, which is made if there are any; each is there whole or as it was before.

        Raises:
            OSError: The disk fails.
        """
        for path, data in self.files.items():
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            write_file(out / path, data.data)


def packed(folder: Path) -> dict[str, NDArray[np.uint8]]:
    """Return the contents of all files below a folder, by path relative to it, with `/`.

    Raises:
        OSError: A file cannot be read.
    """
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): np.fromfile(path, np.uint8) for path in paths}


@dataclass(frozen=True, kw_only=True)
class Luggage:
    """A file or folder that workers on other machines need, such as a checkpoint; it is pickled with its contents."""

    name: str
    files: Mapping[str, NDArray[np.uint8]]

    @classmethod
    def of(cls, path: str | Path) -> Luggage:
        """Pack what is at a path.

        Raises:
            OSError: It cannot be read.
        """
        place = Path(path).resolve()
        files = packed(place) if place.is_dir() else {"": np.fromfile(place, np.uint8)}
        return cls(name=place.name, files=files)

    def unpack(self, folder: Path) -> Path:
        """Write it into a folder, which is made, and return its path."""
        place = folder / self.name
        for name, data in self.files.items():
            path = place / name if name else place
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, data.data)
        return place


class Courier:
    """A worker in a folder of its own; each result takes along the files in the outbox."""

    def __init__(self, make: Callable[[Path], Worker], outbox: str = "") -> None:
        """Make the folder and the worker.

        Args:
            make: Makes the worker, given the path of its folder, which does not exist yet.
            outbox: The folder in it, relative, whose contents are sent and removed after each number; a worker has
                finished its files there by then. The default is the whole folder.
        """
        self._open = ExitStack()
        place = Path(tempfile.gettempdir()).resolve() / FOLDER
        folder = self._open.enter_context(temporary_folder(place))
        self._outbox = folder / outbox
        try:
            self._worker = make(folder)
        except BaseException:
            self._open.close()
            raise

    def attempt(self, number: int) -> Parcel:
        """Return the worker's result for a number, with what it wrote."""
        result = self._worker.attempt(number)
        parcel = Parcel(result=result, files=packed(self._outbox))
        for path in list(self._outbox.iterdir()) if self._outbox.is_dir() else []:
            remove_tree(path)
        return parcel

    def close(self) -> None:
        """Close the worker and remove the folder, whatever fails."""
        try:
            self._worker.close()
        finally:
            self._open.close()
