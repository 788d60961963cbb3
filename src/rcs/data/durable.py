"""Files that survive a kill: every call that changes the disk goes through here, so that tests can stop it anywhere."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

from rcs.data.json_file import MOST_DEPTH, depth_of, parsed_json
from rcs.data.text import check_texts, is_storable
from rcs.errors import CorruptEpisode, DatasetError, InvalidSetup

# A megabyte keeps the number of system calls small; more would not be faster.
_CHUNK = 1 << 20
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW


@contextlib.contextmanager
def disk_errors(doing: str, path: Path) -> Generator[None]:
    """Turn an error of the operating system into one that says what was being done, where, and what to do.

    Args:
        doing: What was being done, such as "write the rows of episode 'a'".
        path: Where.

    Raises:
        DatasetError: Instead of any OSError inside.
    """
    try:
        yield
    except DatasetError:
        raise
    except OSError as err:
        remedy = {
            errno.ENOSPC: " Free some space, then run recover.",
            errno.EDQUOT: " Your quota is used up; free some space, then run recover.",
            errno.EROFS: " The file system is read-only; choose another folder.",
            errno.EACCES: " You have no permission; choose another folder.",
        }.get(err.errno or 0, "")
        raise DatasetError(f"Could not {doing} in {path}: {err.strerror or err}.{remedy}") from err


def write_all(fd: int, data: bytes | memoryview) -> None:
    """Write every byte, though the system may take fewer at a time."""
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def sync_folder(path: Path) -> None:
    """Bring a folder's entries to the disk: names made, renamed or removed in it."""
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def write_file(path: Path, data: bytes) -> None:
    """Put a whole file in place in one step: after a kill there is the old one or the new one.

    The caller syncs the folder when the name itself must be on the disk.
    """
    temporary = path.with_name(path.name + ".tmp")
    # What a kill left, or a link that somebody put there and that would be written through.
    temporary.unlink(missing_ok=True)
    fd = os.open(temporary, _NEW_FILE, 0o644)
    try:
        write_all(fd, data)
        os.fsync(fd)
    finally:
        os.close(fd)
    temporary.replace(path)


def remove_folder(path: Path, trash: Path) -> None:
    """Remove a folder with what is in it; a kill leaves all of it under its name, or nothing.

    Args:
        path: The folder.
        trash: A free name beside it; what a kill leaves under that name is rubbish.
    """
    path.rename(trash)
    with contextlib.suppress(OSError):
        remove_tree(trash)


def remove_tree(path: Path) -> None:
    """Remove a file, or a folder with what is in it; of a link the link and nothing behind it.

    Raises:
        OSError: Something in it cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def link_file(source: Path, target: Path) -> None:
    """Give a file a second name; where the file system has no links, make a copy."""
    try:
        os.link(source, target)
    except OSError as err:
        if err.errno not in (errno.EPERM, errno.EXDEV, errno.EMLINK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        copy_file(source, target)


def copy_file(source: Path, target: Path) -> None:
    """Copy a file's bytes and bring them to the disk.

    Raises:
        OSError: There is no such file, or the disk fails.
    """
    if not source.is_file():  # a pipe would never end
        raise FileNotFoundError(errno.ENOENT, "it is missing or no file", str(source))
    with source.open("rb") as given:
        fd = os.open(target, _NEW_FILE, 0o644)
        try:
            while piece := given.read(_CHUNK):
                write_all(fd, piece)
            os.fsync(fd)
        finally:
            os.close(fd)


class HashedFile:
    """A new file whose SHA-256 is known when it is complete, without reading it again."""

    def __init__(self, path: Path) -> None:
        """Create the file in the place of the one that may be there."""
        path.unlink(missing_ok=True)  # never emptied: it may have other names, or be a link to elsewhere
        self._fd = os.open(path, _NEW_FILE, 0o644)
        self._hash = hashlib.sha256()
        self._pending = bytearray()
        self.closed = False

    def write(self, data: bytes) -> int:
        """Append bytes; they are written in large pieces. What comes after `close` is dropped."""
        if self.closed:
            return len(data)
        self._pending += data
        if len(self._pending) >= _CHUNK:
            self._write_pending()
        return len(data)

    def flush(self) -> None:
        """Do nothing: the bytes matter only once the file is complete."""

    def complete(self) -> str:
        """Bring the file to the disk, close it and return its SHA-256."""
        self._write_pending()
        os.fsync(self._fd)
        self.close()
        return self._hash.hexdigest()

    def close(self) -> None:
        """Close the file; what was not yet written is dropped."""
        if not self.closed:
            self.closed = True
            os.close(self._fd)

    def _write_pending(self) -> None:
        self._hash.update(self._pending)
        with memoryview(self._pending) as view:
            write_all(self._fd, view)
        self._pending.clear()


def sealed(values: Mapping[str, Any]) -> bytes:
    """Return JSON that carries a checksum of itself.

    Raises:
        InvalidSetup: A value is not JSON, or a text that cannot be stored.
    """
    text = json.dumps({**values, "checksum": _checksum(values)}, indent=1, ensure_ascii=False)
    if not is_storable(text):
        check_texts(dict(values), "what is to be stored")
    return text.encode()


def unsealed(data: bytes, path: Path) -> dict[str, Any]:
    """Return the values in sealed JSON.

    Args:
        data: The bytes of the file.
        path: Where they came from, for the message.

    Raises:
        CorruptEpisode: The bytes are not JSON, not the JSON that was written, or more than any dataset has.
    """
    values = parsed_json(data, path)
    checksum = values.pop("checksum", None)
    if checksum is None:
        raise CorruptEpisode(f"{path} is damaged: it has no checksum.")
    if checksum != _checksum(values):
        raise CorruptEpisode(f"{path} is not what was written: its checksum does not match.")
    return values


def is_sealed(data: bytes) -> bool:
    """Return whether JSON has the checksum of its values; of what else is in it nothing is said."""
    try:
        values = json.loads(data)
        return values.pop("checksum") == _checksum(values)
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        return False


def as_json(value: Any) -> Any:
    """Return plain JSON values for what may hold numpy numbers and arrays.

    Raises:
        InvalidSetup: A value is not JSON, is NaN or infinite, which JSON does not have, is nested too deeply, or is a
            text that cannot be stored.
    """
    try:
        plain = json.loads(json.dumps(value, allow_nan=False, default=_plain))
    except (TypeError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"Only JSON can be stored here: {err}. Given: {value!r}.") from err
    if depth_of(plain) > MOST_DEPTH:
        raise InvalidSetup(f"Only JSON of up to {MOST_DEPTH} levels can be stored here.")
    check_texts(plain, "what is to be stored")
    return plain


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy numbers and arrays
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _checksum(values: Mapping[str, Any]) -> str:
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
