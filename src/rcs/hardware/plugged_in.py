"""Devices that are plugged into this machine, as lines for a site file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rcs.errors import MissingDependency
from rcs.extras import package_of
from rcs.hardware.digit import MODEL
from rcs.hardware.serial_port import port_of
from rcs.hardware.usb import UsbDevice, usb_devices

INTEL, REALSENSE = "8086", "RealSense"
"""USB vendor, and part of the product's name."""
SERIAL_CHIPS = {
    "1a86": ("arms", "so101", "a serial adapter such as that of an SO101"),
    "0403": ("hands", "tilburg", "a serial adapter such as the U2D2 of a Tilburg Hand, or of a GELLO"),
}
"""USB vendors of serial adapters (WCH, FTDI), and what they may belong to: kind, driver and words."""
LINKS = Path("/dev/serial")
"""Folder of udev's links to serial ports, by serial number and by place."""


def site_lines(devices: Sequence[UsbDevice] | None = None, links: Path = LINKS) -> list[str]:
    """Return a line per device that a driver takes, with what it is in a comment's place: `"NAME": {...}  what it is`.

    Args:
        devices: The devices; None for those that are plugged in.
        links: Folder of links to serial ports.
    """
    found: list[str] = []
    serials = _realsense_serials()
    for one in _told_apart(usb_devices() if devices is None else devices):
        is_video = any(node.startswith("video") for node in one.nodes)
        if one.vendor_id == INTEL and REALSENSE in one.product:
            address = serials.get(one.path, "")
            hint = "" if address else "; pip install 'robot-control-stack[realsense]' shows its serial number"
            found.append(_line("cameras", "realsense", address, f"{one}{hint}"))
        elif is_video and one.product == MODEL:
            found.append(_line("tactile", "digit", one.address, str(one)))
        elif is_video:
            found.append(_line("cameras", "webcam", one.address, str(one)))
        elif port := port_of(one):
            kind, driver, what = SERIAL_CHIPS.get(one.vendor_id, ("arms", "DRIVER", "a serial port"))
            found.append(_line(kind, driver, _link(one, port, links), f"{what}, now /dev/{port}: {one}"))
    return found or ["Nothing is plugged in that a driver takes: no camera, DIGIT or serial port on USB."]


def lasting_name(path: str) -> str:
    """Return a lasting address of the serial port at a path such as `/dev/ttyUSB0`; empty if it is on no USB bus."""
    for one in _told_apart(usb_devices()):
        if (port := port_of(one)) and f"/dev/{port}" == path:
            return _link(one, port, LINKS)
    return ""


def _told_apart(devices: Sequence[UsbDevice]) -> list[UsbDevice]:
    """Return devices without serial numbers that more than one has, which leaves them their places."""
    counts = Counter(one.serial for one in devices)
    return [replace(one, serial="") if counts[one.serial] > 1 else one for one in devices]


def _line(kind: str, driver: str, address: str, what: str) -> str:
    return f'"{kind}": {{"NAME": {json.dumps({"driver": driver, "address": address})}}}    {what}'


def _link(device: UsbDevice, port: str, links: Path) -> str:
    """Return a name of a serial port that lasts: a link by serial number or place, or without one the address."""
    for kind in ("by-id", "by-path") if device.serial else ("by-path",):
        for link in sorted((links / kind).glob("*")):
            if link.resolve().name == port:
                return str(link)
    return device.address


def _realsense_serials() -> dict[str, str]:
    """Return serial numbers of RealSense cameras by place, since the bus has others; none without the library."""
    try:
        rs = package_of("realsense", "pyrealsense2")
    except MissingDependency:
        return {}
    found: dict[str, str] = {}
    for device in rs.context().query_devices():
        port = device.get_info(rs.camera_info.physical_port)
        for path in str(port).split("/"):
            found[path] = device.get_info(rs.camera_info.serial_number)
    return found
