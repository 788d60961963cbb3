"""The interface of a wire: what speaks a vendor's protocol in front of a virtual robot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from rcs.errors import InvalidSetup

if TYPE_CHECKING:
    from rcs.virtual.fault import Fault
    from rcs.virtual.virtual_robot import VirtualRobot


class Wire(ABC):
    """Takes a vendor's commands to a virtual robot, and tells what it measures.

    A package offers one through the entry-point group `rcs.wires`, under the name of the arm. It listens when it is
    made. The loop of the world calls `receive` as soon as one of `files` can be read, and `tick` before each tick of
    the physics, both in one thread, neither while the controller is frozen. A wire may have threads of its own; these
    leave `robot` alone. Packets go through `robot.line`, which has the faults of the cable.
    """

    rate: ClassVar[int] = 500
    """Ticks per second of the world that this controller needs [Hz]."""
    address: ClassVar[str] = "127.0.0.1"
    """Where it listens when no other place is given; of several robots, each gets `next_address`."""
    faults: ClassVar[Mapping[str, str]] = {}
    """What `tell` takes besides what every robot knows, and the value of each, such as `{"overload": "JOINT"}`."""

    @abstractmethod
    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen.

        Args:
            robot: What it controls.
            address: An address of this machine, a port, or what else the protocol has.

        Raises:
            InvalidSetup: The address is taken or is none; the message has who may hold it.
        """

    @staticmethod
    def next_address(address: str) -> str:
        """Return the address of the next robot: of an IP address, the one after it."""
        start, _, last = address.rpartition(".")
        return f"{start}.{int(last) + 1}"

    @abstractmethod
    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return how the robot's devices are reached: by kind (`arms`, `grippers`), the entry of a `Site`."""

    def files(self) -> Sequence[Any]:
        """Return sockets and file descriptors whose input is to be read at once."""
        return ()

    def receive(self, file: Any) -> None:  # noqa: B027 - a wire with threads has none
        """Read what has come to one of `files`."""

    @abstractmethod
    def tick(self, robot: VirtualRobot) -> None:
        """Lead the robot through the next tick, with what was measured in the last one."""

    def tell(self, fault: Fault) -> None:  # noqa: B027 - a wire may have no faults of its own
        """Have one of `faults` happen.

        Raises:
            InvalidSetup: Its value makes no sense.
        """

    def clear(self) -> None:  # noqa: B027 - nor anything to mend
        """Mend what faults have broken, as a person at the robot does; what is latched until `recover` stays."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the address and end all threads; closing twice is harmless."""


def taken(what: str, address: str, err: OSError) -> InvalidSetup:
    """Return the error of an address at which nobody can listen."""
    return InvalidSetup(
        f"{what} cannot listen at {address!r}: {err.strerror or err}. Another virtual robot may be there; give this "
        "one another address (--address), such as 127.0.0.2."
    )
