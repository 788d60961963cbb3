"""The interface of a driver: how the devices of a vendor are made from an address."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn, TypeVar

from rcs.devices import Arm, Camera, CameraMode, Gripper, Hand
from rcs.errors import InvalidSetup
from rcs.hardware.link import Link
from rcs.robots.description import ArmDescription, CameraDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription

Connection = TypeVar("Connection")


@dataclass(frozen=True, kw_only=True)
class HostTimes:
    """How long calls of a driver in a host may take; a host in which one takes longer is killed, as a fault."""

    answer: float = 0.2
    """A measurement, a command or a stop [s]."""
    open: float = 3.0
    """Connecting, with the import of the vendor's library [s]."""
    recover: float = 15.0
    """Leaving a fault state [s]."""
    close: float = 3.0
    """Letting go [s]."""
    period: float = 0.005
    """Time between a measurement and the next one [s]."""


class Driver:
    """Makes devices. A driver overrides what it has; nothing is connected before a device's `open`.

    A package offers one through the entry-point group `rcs.drivers`, as a class without arguments. One object of it
    makes all devices of a site that name it, so that they can share connections; see `link`.
    """

    hosted: ClassVar[bool] = False
    """Whether its arms, grippers and hands run in a process of their own, one for each address. So do those that call
    a vendor's library from Python: such a library may keep the interpreter, crash, or never return. A site's option
    `host` overrides it."""
    host_times: ClassVar[HostTimes] = HostTimes()
    """How long its calls may take there."""
    gives_way: ClassVar[bool] = False
    """Whether its arms can give way to a push as springs do. The options of `arm` then have `compliance`, a
    `rcs.Compliance` with all its numbers, where the setup has one; else such a setup is refused."""

    def __init__(self) -> None:
        """Connect nothing."""
        self._links: dict[str, Link[Any]] = {}

    def library(self, options: Mapping[str, Any]) -> str:
        """Return which library a device with these options needs, where that cannot share a process with the usual one.

        Hosts serve one library each; "" is the usual one.
        """
        return ""

    def link(
        self, address: str, connect: Callable[[], Connection], disconnect: Callable[[Connection], None]
    ) -> Link[Connection]:
        """Return the connection to an address that all devices there share.

        Args:
            address: Where; the first device that asks decides how it is reached.
            connect: Returns the connection.
            disconnect: Lets go of it.
        """
        return self._links.setdefault(address, Link(connect, disconnect))

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm.

        Args:
            address: Where it is, such as an IP address or a serial port.
            about: Its figures.
            options: What else the site says of it.
        """
        self._refuse("arms")

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> Gripper:
        """Return a gripper; arguments as in `arm`."""
        self._refuse("grippers")

    def hand(self, address: str, about: HandDescription, options: Mapping[str, Any]) -> Hand:
        """Return a hand; arguments as in `arm`."""
        self._refuse("hands")

    def camera(self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]) -> Camera:
        """Return a camera that delivers frames of a mode; other arguments as in `arm`."""
        self._refuse("cameras")

    def tactile(self, address: str, about: TactileDescription, mode: CameraMode, options: Mapping[str, Any]) -> Camera:
        """Return the camera of a tactile sensor; arguments as in `camera`."""
        self._refuse("tactile sensors")

    def _refuse(self, what: str) -> NoReturn:
        raise InvalidSetup(f"The driver {type(self).__name__} has no {what}; choose another driver for them.")
