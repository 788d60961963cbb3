"""Atomic outputs: a result exists whole or not at all, and the next call removes what a kill left.

A result grows beside its place as `.NAME.partial-…`, under a lock that ends with its process. The next call for the
same result removes partial ones whose lock nobody holds.
"""

from __future__ import annotations

import fcntl
import logging
import os
import secrets
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from rcs_data.errors import DatasetError
from rcs_data.files.durable import disk_errors, is_full, remove_tree, sync_folder, synced_at_once
from rcs_data.files.layout import FOLDERS, check_path, has_dataset
from rcs_data.files.lock import DatasetLock, try_lock

OnProgress = Callable[[int, int], object]
"""Called with the number of episodes (of an export or import, steps) done and in all; 0 in all if that is not known."""

_log = logging.getLogger(__name__)

_PARTIAL = ".partial-"
_LOCK = ".lock"


@contextmanager
def new_output(out: str | Path) -> Generator[Path]:
    """Yield a path to write a file or folder to, and move it into place at the end; an error leaves nothing.

    Args:
        out: Where the result goes; an empty folder may be there.

    Raises:
        DatasetError: Something is there already, or the disk fails.
    """
    target = Path(out).absolute()
    refuse_existing(target)
    with disk_errors("write", target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target) as partial:
            try:
                with synced_at_once(target.parent):
                    yield partial
            except DatasetError as err:
                cause = err.__cause__
                if isinstance(cause, OSError) and is_full(cause):
                    raise cause from None  # what was written is removed: nothing is left to recover
                raise
            refuse_existing(target)
            if target.is_dir():
                target.rmdir()
            partial.rename(target)
            sync_folder(target.parent)


@contextmanager
def temporary_folder(target: Path) -> Generator[Path]:
    """Yield a free path beside a target, and remove what is there at the end; the next call does it after a kill.

    Args:
        target: An absolute path, whose folder exists; nothing is done to it.

    Raises:
        OSError: The leftovers of a killed call cannot be removed, or the disk fails.
    """
    remove_leftovers(target)
    partial, lock = _claim(target)
    try:
        yield partial
    finally:
        with suppress(OSError):
            remove_tree(partial)
        _lock_of(partial).unlink(missing_ok=True)
        lock.release()


def leftovers(root: Path) -> list[Path]:
    """Return what killed calls left beside a result; nothing is removed."""
    try:
        return [partial for partial, _ in _abandoned(root.absolute())]
    except OSError:
        return []


def remove_leftovers(target: Path) -> list[Path]:
    """Remove what killed calls left of a result, with a warning each, and return the paths.

    Args:
        target: The result.

    Raises:
        OSError: Something cannot be removed.
    """
    removed: list[Path] = []
    for partial, lock in _abandoned(target):
        if os.path.lexists(partial):
            remove_tree(partial)
            _log.warning("Removed %s, left by a killed call.", partial)
        removed.append(partial)
        lock.unlink(missing_ok=True)
    return removed


def _abandoned(target: Path) -> Generator[tuple[Path, Path]]:
    """Yield what killed calls left beside a result, each with its lock, which is held until the next."""
    start = f".{target.name}{_PARTIAL}"
    names = [path.name for path in target.parent.iterdir()]
    for name in sorted(name for name in names if name.startswith(start) and name.endswith(_LOCK)):
        lock = target.with_name(name)
        try:
            fd = os.open(lock, os.O_RDWR | os.O_NOFOLLOW)
        except OSError:
            continue  # another call was faster, or it is not ours
        try:
            if try_lock(fd, fcntl.LOCK_EX):  # or it is in use
                yield target.with_name(name.removesuffix(_LOCK)), lock
        finally:
            os.close(fd)


def refuse_existing(target: Path) -> None:
    """Raise unless a path is free: nothing there, or an empty folder, and not in a folder that a dataset keeps.

    Raises:
        DatasetError: Something is there, the place is a dataset's, or the path is not UTF-8.
    """
    check_path(target)
    for folder in target.absolute().parents:
        if folder.name in FOLDERS and has_dataset(folder.parent):
            raise DatasetError(f"{target} is in {folder.name}/ of the dataset {folder.parent}. Choose another place.")
    if target.is_symlink() or (target.exists() and not target.is_dir()) or (target.is_dir() and any(target.iterdir())):
        raise DatasetError(f"{target} exists already. Choose another place, or remove it.")


def require_writable(path: str | Path, *, is_file: bool = False) -> None:
    """Raise unless a folder, or a file, can be written at a path; nothing is left there.

    It is tried, because permissions say too little: a file is made and removed in the nearest folder that exists.

    Args:
        path: Where something is going to be written after much work.
        is_file: Whether that is a file.

    Raises:
        DatasetError: It cannot be written.
    """
    target = Path(path).absolute()
    if is_file and target.is_dir():
        raise DatasetError(f"{target} is a folder. Give the path of a file.")
    with disk_errors("write", target):
        if is_file and target.is_file():
            os.close(os.open(target, os.O_WRONLY))
        places = [*target.parents] if is_file else [target, *target.parents]
        with tempfile.TemporaryFile(dir=next(place for place in places if place.exists())):
            pass


def size_on_disk(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    return sum(file.stat().st_size for file in ([path] if path.is_file() else path.rglob("*")) if file.is_file())


def _claim(target: Path) -> tuple[Path, DatasetLock]:
    """Return a free path beside a result, and the lock that keeps others from removing it."""
    while True:
        partial = target.with_name(f".{target.name}{_PARTIAL}{secrets.token_hex(4)}")
        fd = os.open(_lock_of(partial), os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644)
        # Until the lock is held, another call may take the path for a leftover and remove it.
        if try_lock(fd, fcntl.LOCK_EX) and os.fstat(fd).st_nlink:
            return partial, DatasetLock(fd)
        os.close(fd)


def _lock_of(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}{_LOCK}")
