"""A lock that gives a dataset one writer at a time, and ends with the process that holds it.

The operating system's `flock` is free as soon as its process is gone, for whatever reason; the process id in the file
only serves messages. The file is larger than that: its space is a reserve, with which episodes of a full disk can be
deleted; it grows with the index, which an edit writes twice. Worker processes of one collection share a second lock, so
that a new writer does not mistake the episodes of workers that outlive their parent for leftovers.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
import weakref
from collections.abc import Callable
from pathlib import Path

from typing_extensions import Self

from rcs_data.errors import DatasetError
from rcs_data.files.durable import disk_errors, is_full, write_all
from rcs_data.files.layout import INDEX_FILE, unwritable_links

_WRITER_FILE = ".writer.lock"
_WORKERS_FILE = ".workers.lock"
LOCK_FILES = (_WRITER_FILE, _WORKERS_FILE)
# Room for the line of an edit [B], such as the deletion of 3000 episodes, and as often for the index as an edit may
# write it, with some more. It grows by steps [B], of some 25 episodes.
_RESERVE, _INDEXES, _STEP = 1 << 16, 3, 1 << 14
_ID_SIZE = 32
_ATTEMPTS = 5
# Not through a link, since the process id is written into the file.
_LOCK_FILE = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW


class DatasetLock:
    """A lock on a dataset, held until `release` or the end of the process; a fork does not inherit it."""

    def __init__(self, fd: int) -> None:
        """Hold the lock on an open file; use `writer` or `worker` to get one."""
        self._fd: int | None = fd
        # A forked child shares the open file and would keep the lock after its parent's end.
        release = weakref.WeakMethod(self.release)
        os.register_at_fork(after_in_child=lambda: (held := release()) and held())

    @classmethod
    def writer(cls, root: Path) -> DatasetLock:
        """Take the lock that only one process can have.

        Raises:
            DatasetError: Another process writes to this dataset, or the lock file cannot be made.
        """
        with disk_errors("lock the dataset", root):
            _refuse_links(root)
            fd = os.open(root / _WRITER_FILE, _LOCK_FILE, 0o644)
            try:
                if not try_lock(fd, fcntl.LOCK_EX):
                    raise DatasetError(
                        f"Another writer, process {_holder(root)}, has {root} open. Wait for it to end, stop it, "
                        "or choose another folder."
                    )
                workers = os.open(root / _WORKERS_FILE, _LOCK_FILE, 0o644)
                try:
                    if not try_lock(workers, fcntl.LOCK_EX):
                        raise DatasetError(
                            f"Worker processes of an earlier collection still write to {root}. Wait for them to end."
                        )
                finally:
                    os.close(workers)
                try:
                    write_all(fd, f"{os.getpid()}\n".encode().ljust(_ID_SIZE))
                    _grow(fd, root)
                except OSError as err:
                    if not is_full(err):
                        raise
            except BaseException:
                os.close(fd)
                raise
        return cls(fd)

    @classmethod
    def worker(cls, root: Path) -> DatasetLock:
        """Share the lock of another process that is the writer.

        Raises:
            DatasetError: No process is writing to the dataset.
        """
        with disk_errors("join the writers of the dataset", root):
            if not is_locked(root):
                raise DatasetError(f"No writer has {root} open; open it with DatasetWriter.open before workers join.")
            fd = os.open(root / _WORKERS_FILE, _LOCK_FILE, 0o644)
            if not try_lock(fd, fcntl.LOCK_SH):
                os.close(fd)
                raise DatasetError(f"A writer is just opening {root}; join it after that.")
        return cls(fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Give the lock back; calling it twice is harmless."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None


def is_locked(root: Path) -> bool:
    """Return whether a living process is writing to the dataset."""
    try:
        fd = os.open(root / _WRITER_FILE, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:  # missing, or nothing that a writer could lock
        return False
    try:
        return not try_lock(fd, fcntl.LOCK_SH)
    finally:
        os.close(fd)


def grow_reserve(root: Path) -> None:
    """Let a dataset's reserve grow with its index, if the disk lets it: an episode is never refused for its sake."""
    with contextlib.suppress(OSError):
        fd = os.open(root / _WRITER_FILE, os.O_WRONLY | os.O_NOFOLLOW)
        try:
            _grow(fd, root)
        finally:
            os.close(fd)


def _grow(fd: int, root: Path) -> None:
    index = root / INDEX_FILE
    missing = _RESERVE + _INDEXES * (index.stat().st_size if index.exists() else 0) - os.fstat(fd).st_size
    if missing > 0:
        os.lseek(fd, 0, os.SEEK_END)
        write_all(fd, b" " * max(missing, _STEP))


def with_reserve(root: Path, write: Callable[[], object]) -> None:
    """Write something; if the disk is full, give up the dataset's reserve, and write it again.

    Args:
        root: The dataset's folder.
        write: Writes it, whatever a call that failed has left.

    Raises:
        OSError: The disk is full without the reserve, too, or fails.
    """
    try:
        write()
    except OSError as err:
        if not is_full(err):
            raise
        fd = os.open(root / _WRITER_FILE, os.O_WRONLY | os.O_NOFOLLOW)
        try:
            os.ftruncate(fd, 0)
        finally:
            os.close(fd)
        write()


def try_lock(fd: int, kind: int) -> bool:
    """Try to lock an open file by `fcntl.LOCK_EX` or `fcntl.LOCK_SH`; return whether it succeeded."""
    # `is_locked` holds the lock for some microseconds, so one refusal proves nothing.
    for attempt in range(_ATTEMPTS):
        if attempt:
            time.sleep(0.005)
        try:
            fcntl.flock(fd, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            continue
        return True
    return False


def _refuse_links(root: Path) -> None:
    found = unwritable_links(root)
    if found:
        names = ", ".join(f"{path.relative_to(root)} to {path.readlink()}" for path in found)
        raise DatasetError(
            f"{root} has links: {names}. Nothing is written through links. Put what they lead to in their place, or "
            "link the whole dataset."
        )


def _holder(root: Path) -> str:
    with (root / _WRITER_FILE).open("rb") as file:
        text = file.read(_ID_SIZE).decode(errors="replace").strip()
    return text if text.isdecimal() else "with an unknown id"
