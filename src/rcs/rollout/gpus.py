"""Ports and GPUs of servers on this machine: each server has a port, and one of several GPUs, to itself."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path

VARIABLE = "CUDA_VISIBLE_DEVICES"
"""Environment variable that names the GPUs that a program sees."""
_KNOWN = Path("/proc/driver/nvidia/gpus")


def gpus() -> list[str]:
    """Return the names of the GPUs that this program sees, as `CUDA_VISIBLE_DEVICES` has them."""
    if (given := os.environ.get(VARIABLE)) is not None:
        return [name.strip() for name in given.split(",") if name.strip()]
    return [str(number) for number, _ in enumerate(_KNOWN.iterdir())] if _KNOWN.is_dir() else []


@contextmanager
def own_gpu() -> Generator[str | None]:
    """Yield a GPU that no other program of this user has taken here; one is given back at the end, or with its program.

    None where there are not several, or all are taken.
    """
    names = gpus()
    with first_free("gpus", names if len(names) > 1 else ()) as found:
        yield found


@contextmanager
def first_free(kind: str, names: Iterable[str]) -> Generator[str | None]:
    """Yield the first name that no other program of this user has taken here; it is given back as in `own_gpu`.

    None where all are taken.

    Args:
        kind: Kind of things that have the names, such as `gpus`.
        names: Their names; no more of them are taken than are needed.
    """
    folder = Path(tempfile.gettempdir(), f"rcs-{kind}-{os.getuid()}")
    found: str | None = None
    lock = -1
    try:
        for name in names:
            folder.mkdir(mode=0o700, exist_ok=True)
            lock = os.open(
                folder / name.replace("/", "-"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600
            )
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                lock = -1
            else:
                found = name
                break
        yield found
    finally:
        if lock >= 0:
            os.close(lock)
