"""Results that are there whole or not at all."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from rcs.data.durable import disk_errors
from rcs.errors import DatasetError


@contextmanager
def new_output(out: str | Path) -> Generator[Path]:
    """Give a path to write a file or folder to, and put it in place at the end; after an error nothing stays.

    Args:
        out: Where the result goes; an empty folder may be there.

    Raises:
        DatasetError: Something is there already, or the disk fails.
    """
    target = Path(out).absolute()
    refuse_existing(target)
    partial = target.with_name(f"{target.name}.partial-{secrets.token_hex(4)}")
    try:
        with disk_errors("write", target):
            target.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            if target.is_dir():
                target.rmdir()
            partial.rename(target)
    finally:
        if partial.is_dir():
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)


def refuse_existing(target: Path) -> None:
    """Raise unless a path is free: nothing there, or an empty folder.

    Raises:
        DatasetError: Something is there.
    """
    if target.is_file() or (target.is_dir() and any(target.iterdir())):
        raise DatasetError(f"{target} is there already. Choose another place, or remove it.")


def size_on_disk(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    return sum(file.stat().st_size for file in ([path] if path.is_file() else path.rglob("*")) if file.is_file())
