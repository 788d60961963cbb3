"""Workers on other machines: what they need is sent with its files, and the files that they write come back."""

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

from rcs.agents.agent import is_path
from rcs.rollout.pool import Worker

FOLDER = "rcs-worker"
"""In the name of a worker's own folder, which lies in that for temporary files."""

Files = Mapping[str, NDArray[np.uint8]]
"""Contents of files by relative path, with `/`. As arrays they reach another process uncopied."""


def read_files(path: Path, root: Path) -> Files:
    """Return the contents of a file, or of all files below a folder, by path relative to a root.

    Raises:
        OSError: A file cannot be read.
    """
    paths = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    return {each.relative_to(root).as_posix(): np.fromfile(each, np.uint8) for each in paths}


def write_files(files: Files, folder: Path) -> None:
    """Write files into a folder, which is made if there are any; each is there whole or as it was before.

    Raises:
        OSError: The disk fails.
    """
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_file(folder / path, data.data)


@dataclass(frozen=True, kw_only=True)
class SentAgent:
    """An agent for workers on other machines, pickled with the files of its checkpoint."""

    agent: Any
    files: Files

    @classmethod
    def of(cls, agent: Any) -> SentAgent:
        """Read the files of an agent that is the path of a checkpoint.

        Raises:
            OSError: They cannot be read.
        """
        if not is_path(agent):
            return cls(agent=agent, files={})
        path = Path(agent).resolve()
        return cls(agent=path.name, files=read_files(path, path.parent))

    def unpack(self, folder: Path) -> Any:
        """Return the agent, whose files are written into a folder."""
        write_files(self.files, folder)
        return folder / self.agent if self.files else self.agent


class FileWorker:
    """A worker in a temporary folder; each result is returned with the files that were written for it."""

    def __init__(self, make: Callable[[Path], Worker], outbox: str = "") -> None:
        """Make the folder and the worker.

        Args:
            make: Makes the worker, given the path of its folder, which does not exist yet.
            outbox: The folder in it, relative, whose files are returned and removed after each number; the default is
                the whole folder.
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

    def attempt(self, number: int) -> tuple[Any, Files]:
        """Return the worker's result for a number, and the files."""
        result = self._worker.attempt(number)
        files = read_files(self._outbox, self._outbox)
        for path in list(self._outbox.iterdir()) if self._outbox.is_dir() else []:
            remove_tree(path)
        return result, files

    def close(self) -> None:
        """Close the worker and remove the folder, whatever fails."""
        try:
            self._worker.close()
        finally:
            self._open.close()
