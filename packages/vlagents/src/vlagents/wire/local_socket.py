"""The Unix socket beside a server's TCP port, and the removal of sockets that killed servers have left."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import stat
import tempfile
from collections.abc import Generator
from pathlib import Path

from vlagents.errors import InvalidInput


def listen_beside(port: int) -> tuple[socket.socket, Path]:
    """Listen at the Unix socket that belongs to a port, and remove sockets that no server uses any more.

    Args:
        port: TCP port, which this process has.

    Returns:
        The socket and its path. Unlink the path before closing the socket.

    Raises:
        InvalidInput: The folder is not this user's alone.
        OSError: There can be no socket.
    """
    path = socket_beside(port)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _alone_in(path.parent) as is_alone:
            if is_alone:
                _remove_left(path.parent)
            if is_own_socket(path):  # of a server that was killed: the port is ours, so nobody uses it
                path.unlink()
            listener.bind(str(path))
            os.chmod(path, 0o600)
            listener.listen(16)
    except BaseException:
        listener.close()
        raise
    return listener, path


def socket_folder() -> Path:
    """Return the folder of this user's sockets, which no other user may enter.

    Raises:
        InvalidInput: Another user owns it or may enter it.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(base) / "vlagents" if base else Path(tempfile.gettempdir()) / f"vlagents-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise InvalidInput(f"The folder {folder} is not yours alone; remove it, or set XDG_RUNTIME_DIR to one that is.")
    return folder


def socket_beside(port: int) -> Path:
    """Return the path of the Unix socket that belongs to a TCP port on this machine."""
    return socket_folder() / f"{port}.sock"


def is_own_socket(path: Path) -> bool:
    """Return whether a path is a Unix socket of this user."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISSOCK(found.st_mode) and found.st_uid == os.getuid()


@contextlib.contextmanager
def _alone_in(folder: Path) -> Generator[bool]:
    """Make servers that start at the same time wait for each other: an unused socket may be in use a moment later.

    Yields:
        Whether the folder could be locked. On a network file system it cannot, and the sockets there may be those of
        another machine.
    """
    file = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:
            yield False
            return
        try:
            yield True
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)
    finally:
        os.close(file)


def _remove_left(folder: Path) -> None:
    for path in folder.glob("*.sock"):
        if not path.stem.isdecimal() or not is_own_socket(path):
            continue
        # A datagram socket has the wrong type for a socket in use, so this makes no connection.
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asks:
            if asks.connect_ex(str(path)) == errno.ECONNREFUSED:
                path.unlink()
