"""Messages between processes of one user on one machine: headers over a Unix socket, arrays in shared memory.

The memory has no name: its file descriptor travels over the socket. So a killed process leaves nothing behind, and no
other process can open it. It cannot shrink (a seal that the reader checks), so that a reader never touches memory that
is gone. It has two slots: the second is for what is sent while the first is still read, such as after an answer that
was late. Each begins with the number of the message that lies in it, and the reader looks twice: before it copies the
arrays out, and after.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import socket
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.address import Address
from vlagents.errors import BadMessage
from vlagents.wire.link import LARGEST_BODY, Deadline, Link
from vlagents.wire.message import unpack
from vlagents.wire.stream import PREFIX, StreamChannel

MAGIC = b"VLAS"
PLACE = struct.Struct("<QQQ")
"""After the prefix: the message's number, its slot, and how large a slot is [bytes]."""
SLOTS = 2
HEAD = 64
"""Bytes before the arrays of a slot; the first 8 are the message's number."""
LEAST = 64 << 10
"""A body of fewer bytes travels over the socket."""
SEALS = getattr(fcntl, "F_SEAL_SHRINK", 2) | getattr(fcntl, "F_SEAL_GROW", 4) | getattr(fcntl, "F_SEAL_SEAL", 1)


MOST_FILES = 4
"""Files that may arrive before the messages that they belong to."""


def is_supported() -> bool:
    """Return whether this system has memory without a name that can be sealed. Linux has."""
    return hasattr(os, "memfd_create") and hasattr(fcntl, "F_ADD_SEALS") and hasattr(socket, "SO_PEERCRED")


class UnixLink(Link):
    """A Unix socket whose messages may bring files."""

    def __init__(self, connection: socket.socket) -> None:
        """Take over a connected Unix socket."""
        super().__init__(connection)
        self.files: list[int] = []
        """Files that arrived and were not taken yet; they are closed with the link."""

    def send_file(self, frame: memoryview, file: int, deadline: Deadline) -> None:
        """Send a frame and a file with it."""
        count = self._once_ready(self._to_write, deadline, socket.send_fds, self._socket, [frame], [file])
        self.send([frame[count:]], deadline)

    def close(self) -> None:
        """Close the socket, and files that were not taken."""
        super().close()
        while self.files:
            os.close(self.files.pop())

    def _read_now(self, view: memoryview) -> int:
        count, ancillary, _, _ = self._socket.recvmsg_into([view], socket.CMSG_LEN(4), socket.MSG_CMSG_CLOEXEC)
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
                self.files += [number for (number,) in struct.iter_unpack("i", data[: len(data) // 4 * 4])]
        if len(self.files) > MOST_FILES:
            raise BadMessage(f"{len(self.files)} files arrived without a message.")
        return count


class SharedChannel(StreamChannel):
    """A channel over a Unix socket whose large messages lie in shared memory.

    No more than two messages may be on their way at a time: with the third, the slot of the first is used again. While
    there is never more than one, `settled` has each use the slot of the one before, whose memory is at hand: for
    pictures of some megabytes, that takes half as long as two slots in turn.
    """

    def __init__(self, link: UnixLink, *, largest: int = LARGEST_BODY) -> None:
        """Take over a link, as `Channel` does."""
        super().__init__(link, largest=largest)
        self._unix = link
        self._own: NDArray[np.uint8] | None = None
        self._own_file = -1
        self._slot_size = 0
        self._number, self._slot = 0, 0
        self._theirs: NDArray[np.uint8] | None = None
        self._their_slot_size = 0

    def close(self) -> None:
        """Close the socket and let go of the memory."""
        super().close()
        if self._own_file >= 0:
            os.close(self._own_file)
            self._own_file = -1
        self._own, self._theirs = None, None

    def settled(self) -> None:
        """Begin with the first slot again."""
        self._slot = 0

    def _send(self, header: bytes, parts: list[memoryview], size: int, deadline: Deadline) -> None:
        if size < LEAST:
            super()._send(header, parts, size, deadline)
            return
        is_new = self._own is None or size + HEAD > self._slot_size
        if is_new:
            self._make(size + HEAD)
        memory = self._own
        assert memory is not None
        self._number += 1
        slot, self._slot = self._slot, (self._slot + 1) % SLOTS
        start = slot * self._slot_size
        _number(memory, start)[0] = 0  # a reader of this slot notices that it is over
        at = start + HEAD
        for part in parts:
            np.copyto(memory[at : at + len(part)], np.frombuffer(part, np.uint8))  # without Python's lock
            at += len(part)
        _number(memory, start)[0] = self._number
        place = PLACE.pack(self._number, slot, self._slot_size)
        frame = memoryview(PREFIX.pack(MAGIC, len(header), size) + place + header)
        if is_new:
            self._unix.send_file(frame, self._own_file, deadline)
        else:
            self._unix.send([frame], deadline)

    def _make(self, least: int) -> None:
        """Make new memory; the other side keeps the old one for as long as it reads it."""
        size = max(1 << 20, 1 << (least - 1).bit_length())
        file = os.memfd_create("vlagents", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.ftruncate(file, SLOTS * size)
            fcntl.fcntl(file, fcntl.F_ADD_SEALS, SEALS)  # type: ignore[attr-defined]
            memory = np.frombuffer(mmap.mmap(file, SLOTS * size), np.uint8)
        except BaseException:
            os.close(file)
            raise
        if self._own_file >= 0:
            os.close(self._own_file)
        self._own, self._own_file, self._slot_size = memory, file, size

    def _receive(self, deadline: Deadline, begun: Deadline | None) -> Any:
        rest = self._begun(deadline, begun)
        prefix = self._link.take(PREFIX.size, rest)
        if prefix[:4] != MAGIC:
            return self._receive_body(prefix, rest)
        _, header_size, size = PREFIX.unpack(prefix)
        self._check_sizes(header_size, size)
        number, slot, slot_size = PLACE.unpack(self._link.take(PLACE.size, rest))
        header = self._header(header_size, rest)
        if slot_size != self._their_slot_size and self._unix.files:
            file = self._unix.files.pop(0)
            try:
                self._map(file, slot_size)
            finally:
                os.close(file)
        if self._theirs is None or slot_size != self._their_slot_size or slot >= SLOTS or size + HEAD > slot_size:
            raise BadMessage(f"A message of {size} bytes is said to be in slot {slot}, where there is no room for it.")
        start = slot * slot_size
        if _number(self._theirs, start)[0] != number:
            raise BadMessage(f"Slot {slot} does not hold message {number}.")
        body = self._room(size)
        np.copyto(body, self._theirs[start + HEAD : start + HEAD + size])  # without Python's lock
        if _number(self._theirs, start)[0] != number:
            raise BadMessage("The other side wrote over a message that was being read.")
        return unpack(header, body)

    def _map(self, file: int, slot_size: int) -> None:
        """Look at the other side's memory, if it is what it should be.

        Raises:
            BadMessage: It is not, or larger than allowed.
        """
        if not HEAD < slot_size <= 2 * max(self.largest + HEAD, 1 << 20):
            raise BadMessage(f"A slot of {slot_size} bytes is too large; valid are up to twice {self.largest}.")
        try:
            is_sealed = bool(fcntl.fcntl(file, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK)  # type: ignore[attr-defined]
        except OSError:
            is_sealed = False
        if not is_sealed or os.fstat(file).st_size != SLOTS * slot_size:
            raise BadMessage(f"The shared memory is not sealed, or does not have {SLOTS} slots of {slot_size} bytes.")
        view = np.frombuffer(mmap.mmap(file, SLOTS * slot_size, prot=mmap.PROT_READ), np.uint8)
        self._theirs, self._their_slot_size = view, slot_size


def name_beside(address: Address) -> str:
    """Return the name of the Unix socket beside a TCP port of this machine.

    It is abstract (unix(7)): no file has it, so a server that is killed leaves nothing behind, and it is of the same
    network namespace as the port. Any user may connect, so both sides compare `peer_user`.
    """
    host = "127.0.0.1" if address.host == "localhost" else address.host
    return f"\0vlagents/{os.getuid()}/{host}/{address.port}"


def peer_user(connection: socket.socket) -> int:
    """Return the id of the user on the other side of a Unix socket, by the kernel."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return int(struct.unpack("3i", credentials)[1])


def _number(memory: NDArray[np.uint8], start: int) -> NDArray[np.uint64]:
    """Return the number of the message in a slot, (1,), as it is in memory."""
    return memory[start : start + 8].view(np.uint64)
