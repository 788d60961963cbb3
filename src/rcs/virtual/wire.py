"""The interface of wires, which implement a vendor's protocol for a virtual robot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from rcs.errors import InvalidSetup

if TYPE_CHECKING:
    from rcs.virtual.fault import Fault
    from rcs.virtual.virtual_robot import VirtualRobot


class Wire(ABC):
    """A vendor's protocol: passes commands to a virtual robot and sends its measurements.

    A package registers its wire in the entry-point group `rcs.wires` under the name of the arm. The wire listens from
    its construction on. The loop of the world calls `receive` as soon as one of `files` can be read, and `tick` before
    each tick of the physics, both in one thread and neither while the controller is frozen. A wire may have threads of
    its own, which must not use `robot`. All packets pass `robot.line`, which applies the faults of the cable.
    """

    rate: ClassVar[int] = 500
    """Ticks per second of the world that this controller needs [Hz]."""
    address: ClassVar[str] = "127.0.0.1"
    """Default address of the first robot; further robots get `next_address`."""
    faults: ClassVar[Mapping[str, str]] = {}
    """Faults of `tell` in addition to those of every robot, with their values, such as `{"overload": "JOINT"}`."""

    @abstractmethod
    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen.

        Args:
            robot: Robot that the wire controls.
            address: An address of this machine, a port, or the like, depending on the protocol.

        Raises:
            InvalidSetup: The address is invalid or taken; the message says what may use it.
        """

    @staticmethod
    def next_address(address: str) -> str:
        """Return the address of the next robot, by default the next IP address."""
        start, _, last = address.rpartition(".")
        return f"{start}.{int(last) + 1}"

    @abstractmethod
    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the robot's entries of a `Site` by kind (`arms`, `grippers`)."""

    def files(self) -> Sequence[Any]:
        """Return sockets and file descriptors to read from as soon as input arrives."""
        return ()

    def receive(self, file: Any) -> None:  # noqa: B027 - a wire with threads has none
        """Read the input of one of `files`."""

    @abstractmethod
    def tick(self, robot: VirtualRobot) -> None:
        """Command the robot for the next tick, given the measurements of the last one."""

    def tell(self, fault: Fault) -> None:  # noqa: B027 - a wire may have no faults of its own
        """Apply one of `faults`.

        Raises:
            InvalidSetup: The value is invalid.
        """

    def clear(self) -> None:  # noqa: B027 - and then nothing to clear
        """End faults like a person at the robot; faults that are latched until `recover` remain."""

    @abstractmethod
    def close(self) -> None:
        """Release the address and end all threads; closing twice is harmless."""


def taken(what: str, address: str, err: OSError) -> InvalidSetup:
    """Return the error for an address on which the wire cannot listen."""
    return InvalidSetup(
        f"{what} cannot listen at {address!r}: {err.strerror or err}. Another virtual robot may use it; give this "
        "one another address (--address), such as 127.0.0.2."
    )
