"""Devices that are plugged into this machine's USB ports, from `/sys`: names that last, the bus and its rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from rcs.errors import InvalidSetup

SYS = Path("/sys")
BY_PATH = "usb:"
"""Start of an address that is a place on the bus, such as `usb:1-2.3`."""


@dataclass(frozen=True, kw_only=True)
class UsbDevice:
    """A device on a USB bus."""

    path: str
    """Place on the bus, such as `1-2.3`; stays the same as long as the cable stays in its port."""
    serial: str = ""
    """Serial number; empty for devices without one."""
    product: str = ""
    vendor_id: str = ""
    """Four hexadecimal digits."""
    product_id: str = ""
    """Four hexadecimal digits."""
    bus: int = 0
    """Number of the bus, which devices share."""
    speed: float = 0.0
    """Rate of the connection [Mbit/s]: 480 for USB 2, 5000 and more for USB 3."""
    nodes: tuple[str, ...] = ()
    """Files in `/dev`, such as `video0` or `ttyUSB0`; the first of a camera gives its pictures."""

    @property
    def address(self) -> str:
        """Serial number, or else the place."""
        return self.serial or f"{BY_PATH}{self.path}"

    def __str__(self) -> str:
        """Return product, address and rate in words."""
        return f"{self.product or 'a device'} ({self.address}) at USB {self.path}, {self.speed:g} Mbit/s"


@dataclass(frozen=True, kw_only=True)
class Plug:
    """Where a camera is plugged in, and what it needs of its bus."""

    device: UsbDevice
    needs: float
    """Rate that its pictures need [Mbit/s]."""


@runtime_checkable
class Plugged(Protocol):
    """A camera on a USB port."""

    def plug(self) -> Plug | None:
        """Return its place, without opening it; None if it is elsewhere, such as on a network.

        Raises:
            InvalidSetup: It is not plugged in.
        """
        ...


def usb_devices(root: Path | None = None) -> list[UsbDevice]:
    """Return all USB devices but hubs, in the order of their places."""
    root = SYS if root is None else root
    nodes = _nodes(root)
    found: list[UsbDevice] = []
    for folder in sorted((root / "bus/usb/devices").glob("*")):
        if not (folder / "idVendor").exists() or _text(folder / "bDeviceClass") == "09":
            continue
        found.append(
            UsbDevice(
                path=folder.name,
                serial=_text(folder / "serial"),
                product=_text(folder / "product"),
                vendor_id=_text(folder / "idVendor"),
                product_id=_text(folder / "idProduct"),
                bus=int(_text(folder / "busnum") or 0),
                speed=float(_text(folder / "speed") or 0.0),
                nodes=tuple(name for _, _, name in sorted(nodes.get(folder.resolve(), ()))),
            )
        )
    return found


def find(address: str, among: Sequence[UsbDevice], what: str) -> UsbDevice:
    """Return the device with a serial number or place.

    Args:
        address: Serial number, or `usb:` and a place such as `usb:1-2.3`.
        among: The devices that may be meant.
        what: Their kind in messages, such as "webcam".

    Raises:
        InvalidSetup: There is none, or more than one; the message lists those that are there.
    """
    matching = [one for one in among if address in (one.serial, f"{BY_PATH}{one.path}") and address]
    if len(matching) == 1:
        return matching[0]
    there = "; ".join(map(str, among)) or "none"
    if matching:
        raise InvalidSetup(
            f"{len(matching)} devices have the serial number {address!r}; give the place of one, such as "
            f"{BY_PATH}{matching[0].path}. Plugged in: {there}."
        )
    raise InvalidSetup(
        f"No {what} has the serial number or place {address!r}. Plugged in: {there}. Numbers as in /dev/video0 change "
        "with the order of plugging; they are not valid."
    )


def require_plugs(cameras: Mapping[str, object]) -> None:
    """Check, before any is opened, that cameras are different devices and fit on their buses.

    Args:
        cameras: Cameras by name; those that are no `Plugged` are ignored.

    Raises:
        InvalidSetup: One is not plugged in, two are the same device, or those of one bus need more than it carries.
    """
    plugs: dict[str, Plug] = {}
    for name, camera in cameras.items():
        plug = camera.plug() if isinstance(camera, Plugged) else None
        if plug is None:
            continue
        for other, taken in plugs.items():
            if taken.device.path == plug.device.path:
                raise InvalidSetup(
                    f"Cameras {other!r} and {name!r} are both {plug.device}; give {name!r} a device of its own."
                )
        plugs[name] = plug
    for bus in {plug.device.bus for plug in plugs.values()}:
        here = {name: plug for name, plug in plugs.items() if plug.device.bus == bus}
        slowest = min(plug.device.speed for plug in here.values())
        sums = [(sum(plug.needs for plug in here.values()), max(plug.device.speed for plug in here.values()))]
        sums += [(plug.needs, plug.device.speed) for plug in here.values()]
        for needed, speed in sums:
            if needed > (room := capacity(speed)):
                each = ", ".join(f"{name} {plug.needs:.0f} ({plug.device})" for name, plug in here.items())
                hint = " A cable or port of USB 3 carries ten times as much." if slowest < 5000 else ""
                raise InvalidSetup(
                    f"Cameras on USB bus {bus} need {needed:.0f} Mbit/s of {room:.0f} at {speed:g} Mbit/s: {each}. Use "
                    f"smaller pictures or lower rates, or a port of another controller.{hint}"
                )


def capacity(speed: float) -> float:
    """Return what pictures may take of a connection [Mbit/s].

    Args:
        speed: Its rate [Mbit/s].

    The share is 80 % (USB 2.0 specification, 5.6.4, periodic transfers), of 8 in 10 bits from USB 3 on.
    """
    return 0.8 * speed * (0.8 if speed >= 5000 else 1.0)


def _nodes(root: Path) -> dict[Path, list[tuple[str, int, str]]]:
    """Return (class, index, name) of device files by the folder of their USB device."""
    found: dict[Path, list[tuple[str, int, str]]] = {}
    for kind in ("video4linux", "tty", "hidraw"):
        for entry in (root / "class" / kind).glob("*"):
            folder = (entry / "device").resolve()
            for parent in _upwards(folder, root):
                if (parent / "idVendor").exists():
                    found.setdefault(parent, []).append((kind, int(_text(entry / "index") or 0), entry.name))
                    break
    return found


def _upwards(folder: Path, root: Path) -> Iterable[Path]:
    top = root.resolve()
    while top in folder.parents:
        yield folder
        folder = folder.parent


def _text(file: Path) -> str:
    try:
        return file.read_text("utf-8", "replace").strip()
    except OSError:  # an attribute that this device does not have
        return ""
