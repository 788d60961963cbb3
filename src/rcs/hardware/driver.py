"""The interface of a driver, which makes a vendor's devices from an address."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn, TypeVar

from rcs.devices import Arm, Camera, CameraMode, Gripper, Hand, lookup
from rcs.errors import InvalidSetup
from rcs.hardware.link import Link
from rcs.robots.camera import CameraDescription
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription

Connection = TypeVar("Connection")


@dataclass(frozen=True, kw_only=True)
class HostTimes:
    """Time limits for calls of a driver in a host; exceeding one kills the host and puts the device at fault."""

    answer: float = 0.2
    """Limit for a measurement, a command or a stop [s]."""
    open: float = 3.0
    """Limit for connecting, including the import of the vendor's library [s]."""
    recover: float = 15.0
    """Limit for leaving a fault state, and for giving way to a person's hand [s]."""
    close: float = 3.0
    """Limit for disconnecting [s]."""
    period: float = 0.005
    """Time between two measurements [s]."""


class Driver:
    """Base class of drivers. Override a method per kind of device; a device connects in its `open`, not before.

    A package registers its driver, a class without arguments, in the entry-point group `rcs.drivers`. A single instance
    makes all devices of a site that name the driver, so that they can share connections; see `link`.
    """

    hosted: ClassVar[bool] = False
    """True to run arms, grippers and hands in a separate process, one per address. Set it for drivers that call a
    vendor's library from Python: such a library may hold the GIL, crash, or never return. A site's option `host`
    overrides it."""
    host_times: ClassVar[HostTimes] = HostTimes()
    """Time limits of calls in that process."""
    shares_options: ClassVar[bool] = False
    """True if an arm's options are its end effector's, too, where both have a single entry; with False, only the option
    `host` is."""
    gives_way: ClassVar[bool] = False
    """True if arms can yield to a push like springs. The options of `arm` then contain `compliance`, a complete
    `rcs.Compliance`, if the setup has one. With False, such a setup is refused."""

    def __init__(self) -> None:
        """Create the driver without connecting to a device."""
        self._links: dict[str, Link[Any]] = {}

    def library(self, options: Mapping[str, Any]) -> str:
        """Return the library that a device needs if it cannot share a process with the usual one; "" for the usual one.

        Each host serves a single library.
        """
        return ""

    def link(
        self, address: str, connect: Callable[[], Connection], disconnect: Callable[[Connection], None]
    ) -> Link[Connection]:
        """Return the connection that all devices at an address share.

        Args:
            address: Address of the devices; the functions of the first caller are used.
            connect: Opens and returns the connection.
            disconnect: Closes it.
        """
        return self._links.setdefault(address, Link(connect, disconnect))

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm.

        Args:
            address: IP address, serial port or the like.
            about: Description of the arm.
            options: The site's options for this device.
        """
        self._refuse("arms")

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> Gripper:
        """Return a gripper; arguments as in `arm`."""
        self._refuse("grippers")

    def hand(self, address: str, about: HandDescription, options: Mapping[str, Any]) -> Hand:
        """Return a hand; arguments as in `arm`."""
        self._refuse("hands")

    def camera(self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]) -> Camera:
        """Return a camera that delivers frames in the given mode; other arguments as in `arm`."""
        self._refuse("cameras")

    def tactile(self, address: str, about: TactileDescription, mode: CameraMode, options: Mapping[str, Any]) -> Camera:
        """Return the camera of a tactile sensor; arguments as in `camera`."""
        self._refuse("tactile sensors")

    def _refuse(self, what: str) -> NoReturn:
        raise InvalidSetup(f"The driver {type(self).__name__} makes no {what}; choose another driver for them.")


def driver_named(name: str) -> Driver:
    """Return a new instance of a driver.

    Args:
        name: An entry point of `rcs.drivers`, or `module:Class`.

    Raises:
        UnknownName: There is no such driver.
        InvalidSetup: The name is that of something else.
    """
    found = lookup.find("driver", name)
    if not isinstance(found, type) or not issubclass(found, Driver):
        raise InvalidSetup(f"The driver {name!r} is {found!r}; valid is a subclass of rcs.hardware.Driver.")
    return found()


def require_address(what: str, address: str) -> None:
    """Check that a site gives the network address of a device.

    Raises:
        InvalidSetup: It is empty.
    """
    if not address:
        raise InvalidSetup(f"The {what} has no address; give its IP address, as in 'driver:192.168.0.1'.")


def require_fits(driver: str, about: ArmDescription, known: ArmDescription) -> None:
    """Check that a description is that of the arm that a driver controls: as many joints, in no wider ranges.

    Raises:
        InvalidSetup: It is that of another arm.
    """
    if about.dof != known.dof:
        what = f"has {about.dof} joints, not {known.dof}"
    else:
        own, usual = (zip(one.joint_lower, one.joint_upper, strict=True) for one in (about, known))
        wider = [
            f"{joint} from {lower:.2f} to {upper:.2f} rad, not {least:.2f} to {most:.2f}"
            for joint, (lower, upper), (least, most) in zip(known.joints, own, usual, strict=True)
            if lower < least - 1e-6 or upper > most + 1e-6
        ]
        if not wider:
            return
        what = f"has {wider[0]}"
    raise InvalidSetup(
        f"The driver {driver} controls the {known.label}; {about.name!r} {what}. Choose the robot {known.name!r}, or "
        "the driver of that arm."
    )
