"""The Unix socket beside a server's port, and what servers that were killed have left of theirs."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
from collections.abc import Generator
from pathlib import Path

from vlagents.address import is_own_socket, socket_beside


def listen_beside(port: int) -> tuple[socket.socket, Path]:
    """Listen at the Unix socket that belongs to a port, and remove those that nobody has any more.

    Args:
        port: Of TCP; this process has it.

    Returns:
        What listens, and where. Whoever closes the one unlinks the other before.

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


@contextlib.contextmanager
def _alone_in(folder: Path) -> Generator[bool]:
    """Have servers that start at the same time wait for each other: what seems left may be theirs a moment later.

    Yields:
        Whether the folder could be locked. On a network's file system it cannot, and others' sockets may be those of
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
        # Where somebody has the socket, one of datagrams is of the wrong type, and no connection comes of it.
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asks:
            if asks.connect_ex(str(path)) == errno.ECONNREFUSED:
                path.unlink()
