"""How a virtual robot is told of faults, and asked: a datagram on a socket of this machine, open to its user alone.

The socket has a name without a file (Linux's abstract names), which ends with the process.
"""

from __future__ import annotations

import json
import os
import socket
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rcs.errors import InvalidSetup, RcsError, UnknownName

PATIENCE = 3.0
"""How long a robot that is told something may take to answer [s]."""
_MOST = 65536
_CREDENTIALS = struct.Struct("3i")


class Control:
    """The end at which a virtual robot is told something."""

    def __init__(self, wanted: str) -> None:
        """Take a name: the wanted one, or one with a number where it is taken."""
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        number = 1
        while True:
            self.name = wanted if number == 1 else f"{wanted}-{number}"
            try:
                self.socket.bind(_address(self.name))
                break
            except OSError:  # the name is taken
                number += 1

    def answer(self, act: Callable[[list[str]], str]) -> None:
        """Do what has been asked for, if anything, and send what there is to say.

        Args:
            act: Takes the words, and returns the answer; its `RcsError` goes back in the answer's place.
        """
        try:
            packet, extra, _, sender = self.socket.recvmsg(_MOST, socket.CMSG_SPACE(_CREDENTIALS.size))
        except BlockingIOError:
            return
        users = [_CREDENTIALS.unpack(data)[1] for _, kind, data in extra if kind == socket.SCM_CREDENTIALS]
        if users != [os.getuid()]:
            return
        try:
            words = json.loads(packet)
            reply = {"answer": act([str(word) for word in words])}
        except (RcsError, ValueError, RecursionError) as err:
            reply = {"error": str(err)}
        try:
            self.socket.sendto(json.dumps(reply).encode(), sender)
        except OSError:  # who asked is gone
            return

    def close(self) -> None:
        """Give the name back; closing twice is harmless."""
        self.socket.close()


def tell(name: str, words: Sequence[str]) -> str:
    """Tell a virtual robot something, wait until it is done, and return the answer, which is empty for most.

    Args:
        name: Name of the robot, as `rcs virtual` prints it; of one of several, `name/robot`.
        words: A fault and its value, such as `("lose", "3")`, or a question, such as `("judge",)`.

    Raises:
        UnknownName: No such virtual robot runs, or it has no such fault; the message has the valid ones.
        InvalidSetup: The robot refuses, or does not answer.
    """
    process, _, robot = name.partition("/")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.bind("")  # a name that the system chooses, to answer to
        own.settimeout(PATIENCE)
        try:
            own.connect(_address(process))
        except ConnectionRefusedError as err:
            raise UnknownName("running virtual robot", process, running()) from err
        own.send(json.dumps([robot, *words]).encode())
        try:
            reply: dict[str, Any] = json.loads(own.recv(_MOST))
        except TimeoutError as err:
            raise InvalidSetup(f"The virtual robot {process!r} has not answered for {PATIENCE:g} s.") from err
    if "error" in reply:
        raise InvalidSetup(reply["error"])
    return reply["answer"]


def running() -> list[str]:
    """Return the names of the virtual robots that run."""
    start = "@" + _address("")[1:]
    words = [line.split()[-1] for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
    return sorted({word.removeprefix(start) for word in words if word.startswith(start)})


def _address(name: str) -> str:
    return f"\0rcs-virtual-{os.getuid()}-{name}"
