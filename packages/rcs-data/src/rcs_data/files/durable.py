"""Files that survive a kill: every call that changes the disk is made here, so that tests can interrupt any of them."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import json
import os
import shutil
from collections.abc import Generator, Iterable, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.json_file import parsed_json
from rcs_data.files.layout import QUARANTINE_FOLDER
from rcs_data.files.text import check_texts, is_storable

# A megabyte keeps system calls few; more is not faster.
_CHUNK = 1 << 20
_is_draft = ContextVar("is_draft", default=False)
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW


def is_full(err: OSError) -> bool:
    """Return whether an error says that the disk is full, or a quota used up."""
    return err.errno in (errno.ENOSPC, errno.EDQUOT)


@contextlib.contextmanager
def disk_errors(doing: str, path: Path, *, keeps_rows: bool = False) -> Generator[None]:
    """Turn an OSError into one that says what was being done, where, and what to do.

    Args:
        doing: The action that was under way, such as "write the rows of episode 'a'".
        path: Where.
        keeps_rows: Whether rows of an episode stay on the disk, of which `recover` makes an episode.

    Raises:
        DatasetError: Instead of any OSError inside.
    """
    try:
        yield
    except DatasetError:
        raise
    except OSError as err:
        then = "run recover" if keeps_rows else "repeat it"
        remedy = {
            errno.ENOSPC: f" Free some space, then {then}.",
            errno.EDQUOT: f" Your quota is used up; free some space, then {then}.",
            errno.EROFS: " The file system is read-only; choose another folder.",
            errno.EACCES: " You have no permission; choose another folder.",
        }.get(err.errno or 0, "")
        raise DatasetError(f"Could not {doing} in {path}: {err.strerror or err}.{remedy}") from err


def write_all(fd: int, data: bytes | memoryview) -> None:
    """Write every byte, though the system may take fewer at a time."""
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def append(fd: int, end: int, data: bytes) -> None:
    """Write behind the last whole line of an open file and sync it; after a failure, nothing of it is there.

    Args:
        fd: The open file.
        end: Where the last whole line ends; a killed writer may have left half of another one.
        data: The bytes.

    Raises:
        OSError: The disk is full or fails.
    """
    os.ftruncate(fd, end)
    os.lseek(fd, end, os.SEEK_SET)
    try:
        write_all(fd, data)
        sync(fd)
    except BaseException:
        os.ftruncate(fd, end)
        raise


def sync(fd: int) -> None:
    """Bring an open file or folder to the disk, unless everything is to be at once.

    Raises:
        OSError: The disk fails.
    """
    if not _is_draft.get():
        os.fsync(fd)


@contextlib.contextmanager
def synced_at_once(folder: Path) -> Generator[None]:
    """Sync nothing that the block writes, and everything at its end, which is far faster than file by file.

    A kill, or a failing power, in the block must leave nothing that anybody reads.

    Args:
        folder: A folder of the same file system.

    Raises:
        OSError: The disk fails.
    """
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # before the block: it also gets to know what failed in between
    try:
        token = _is_draft.set(True)
        try:
            yield
        finally:
            _is_draft.reset(token)
        sync_file_system(fd)
    finally:
        os.close(fd)


def sync_file_system(fd: int) -> None:
    """Bring everything on the file system of an open file or folder to the disk.

    Raises:
        OSError: The disk fails.
    """
    import ctypes  # which most programs do not need

    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "syncfs"):  # only Linux has it
        os.sync()
    elif libc.syncfs(fd) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def sync_folder(path: Path) -> None:
    """Sync a folder, so that names made, renamed or removed in it are on the disk."""
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        sync(fd)
    finally:
        os.close(fd)


def write_file(path: Path, *pieces: bytes | memoryview, more: Iterable[bytes] = ()) -> None:
    """Replace a whole file in one step: after a kill, either the old or the new one is there.

    The caller syncs the folder if the name itself must be on the disk.

    Args:
        path: The file.
        pieces: Its bytes, in order.
        more: More of them, which are written as they come.
    """
    temporary = path.with_name(path.name + ".tmp")
    # Left by a kill, or a link that would be written through.
    temporary.unlink(missing_ok=True)
    fd = os.open(temporary, _NEW_FILE, 0o644)
    try:
        for piece in itertools.chain(pieces, more):
            write_all(fd, piece)
        sync(fd)
    except BaseException:  # half of it would take space that a full disk does not have
        temporary.unlink(missing_ok=True)
        raise
    finally:
        os.close(fd)
    temporary.replace(path)


def remove_folder(path: Path, trash: Path) -> None:
    """Remove a folder with its contents; a kill leaves either all of it or none under its name.

    On a full disk that has no space for the place, it is removed where it is, and a kill leaves a part of it.

    Args:
        path: The folder.
        trash: A free place on the same file system; whatever a kill leaves there is garbage.
    """
    try:
        trash.parent.mkdir(exist_ok=True)
        path.rename(trash)
    except OSError as err:
        if not is_full(err):
            raise
        remove_tree(path)
        return
    with contextlib.suppress(OSError):
        remove_tree(trash)


def remove_tree(path: Path) -> None:
    """Remove a file, a folder with its contents, or a link without its target.

    Raises:
        OSError: Something in it cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def quarantine(root: Path, path: Path, name: str = "") -> Path:
    """Put a damaged file or folder of a dataset aside, unchanged, at a free name where nothing reads it; return that.

    Args:
        root: The dataset's folder.
        path: The file or folder.
        name: Model for its name there; the name that it has if this is empty.

    Raises:
        DatasetError: It cannot be moved.
        OSError: The disk is full or fails.
    """
    folder = root / QUARANTINE_FOLDER
    folder.mkdir(exist_ok=True)
    target = folder / (name or path.name)
    number = 1
    while target.exists():
        number += 1
        target = folder / f"{name or path.name}-{number}"
    try:
        path.rename(target)
    except OSError as err:
        raise DatasetError(f"Cannot move {path} to {target}: {err.strerror or err}.") from err
    sync_folder(folder)
    sync_folder(path.parent)
    return target


def link_file(source: Path, target: Path) -> None:
    """Hard-link a file, or copy it where the file system has no links.

    Raises:
        OSError: There is no such file, or the disk fails.
    """
    try:
        os.link(source.resolve(), target)  # of a link, the file that it leads to
    except OSError as err:
        if err.errno not in (errno.EPERM, errno.EXDEV, errno.EMLINK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        if not source.is_file():  # a device never ends
            raise FileNotFoundError(errno.ENOENT, "it is missing or not a file", str(source)) from err
        shutil.copyfile(source, target)
        fd = os.open(target, os.O_RDONLY)
        try:
            sync(fd)
        finally:
            os.close(fd)


class HashedFile:
    """A new file that is hashed with SHA-256 while it is written."""

    def __init__(self, path: Path) -> None:
        """Create the file, replacing any that is there."""
        path.unlink(missing_ok=True)  # not truncated: it may have other names, or be a link
        self._fd = os.open(path, _NEW_FILE, 0o644)
        self._hash = hashlib.sha256()
        self._pending = bytearray()
        self.closed = False

    def write(self, data: bytes | memoryview) -> int:
        """Append bytes, buffered in large pieces. After `close` they are dropped."""
        if self.closed:
            return len(data)
        if len(data) >= _CHUNK:  # not copied
            self._write_pending()
            self._hash.update(data)
            write_all(self._fd, data)
            return len(data)
        self._pending += data
        if len(self._pending) >= _CHUNK:
            self._write_pending()
        return len(data)

    def flush(self) -> None:
        """Do nothing: the bytes matter only once the file is complete."""

    def complete(self) -> str:
        """Sync the file, close it and return its SHA-256."""
        self._write_pending()
        sync(self._fd)
        self.close()
        return self._hash.hexdigest()

    def close(self) -> None:
        """Close the file; what is still buffered is dropped."""
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
        InvalidSetup: A value is not JSON, or is text that cannot be stored.
    """
    text = json.dumps({**values, "checksum": _checksum(values)}, indent=1, ensure_ascii=False)
    if not is_storable(text):
        check_texts(dict(values), "what is to be stored")
    return text.encode()


def unsealed(data: bytes, path: Path) -> dict[str, Any]:
    """Return the values in sealed JSON.

    Args:
        data: The bytes of the file.
        path: The file, for the message.

    Raises:
        CorruptEpisode: The bytes are not JSON, or not the JSON that was written.
    """
    values = parsed_json(data, path)
    checksum = values.pop("checksum", None)
    if checksum is None:
        raise CorruptEpisode(f"{path} is damaged: it has no checksum.")
    if checksum != _checksum(values):
        raise CorruptEpisode(f"{path} is not what was written: its checksum does not match.")
    return values


def as_json(value: Any) -> Any:
    """Return plain JSON values for values that may hold numpy numbers and arrays.

    Raises:
        InvalidSetup: A value is not JSON, is NaN or infinite, or is text that cannot be stored.
    """
    try:
        plain = json.loads(json.dumps(value, allow_nan=False, default=_plain))
    except (TypeError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"Expected JSON values ({err}); got {value!r}.") from err
    check_texts(plain, "what is to be stored")
    return plain


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy numbers and arrays
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _checksum(values: Mapping[str, Any]) -> str:
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
