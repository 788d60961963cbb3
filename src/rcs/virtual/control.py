"""The control socket of a virtual robot, through which it receives faults and questions.

It is a datagram socket with an abstract Unix name of this user, which disappears with the process.
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
"""Timeout for the answer of a virtual robot [s]."""
_MOST = 65536
_CREDENTIALS = struct.Struct("3i")


class Control:
    """The virtual robot's end of its control socket."""

    def __init__(self, wanted: str) -> None:
        """Bind a name: the wanted one, with a number appended if it is taken."""
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
        """Execute a pending request, if any, and send the answer.

        Args:
            act: Executes the words and returns the answer; if it raises an `RcsError`, the error is sent instead.
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
        except OSError:  # the sender has ended
            return

    def close(self) -> None:
        """Release the name; closing twice is harmless."""
        self.socket.close()


def tell(name: str, words: Sequence[str]) -> str:
    """Send a fault or question to a virtual robot, wait until it is done, and return the answer, "" for faults.

    Args:
        name: Name of the robot, as `rcs virtual` prints it; `name/robot` for one of several.
        words: A fault and its value, such as `("lose", "3")`, or a question, such as `("judge",)`.

    Raises:
        UnknownName: No such virtual robot is running, or it has no such fault; the message lists the valid ones.
        InvalidSetup: The robot refuses, or does not answer.
    """
    process, _, robot = name.partition("/")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.bind("")  # a name of the system's choice, for the answer
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
    """Return the names of the running virtual robots."""
    start = "@" + _address("")[1:]
    words = [line.split()[-1] for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
    return sorted({word.removeprefix(start) for word in words if word.startswith(start)})


def _address(name: str) -> str:
    return f"\0rcs-virtual-{os.getuid()}-{name}"
