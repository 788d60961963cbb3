"""Serial ports: found by names that last, one program at a time, and remedies for those that cannot be opened."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

from rcs.errors import DeviceFault
from rcs.hardware.programs import holders, program_of
from rcs.hardware.usb import UsbDevice, find, usb_devices


def port_at(address: str, what: str) -> str:
    """Return the path of a serial port.

    Args:
        address: Its path, or serial number or place (`usb:1-2.3`) of a device on a USB bus.
        what: Name of what is there for messages, such as "servo bus".

    Raises:
        InvalidSetup: No device with a port has this number or place, or more than one; the message lists them.
    """
    if "/" in address or os.path.exists(address):
        return address
    return f"/dev/{port_of(find(address, _with_ports(), what))}"


def port_of(device: UsbDevice) -> str:
    """Return the name in `/dev` of the serial port of a device; empty for a device without one."""
    return next((node for node in device.nodes if node.startswith("tty")), "")


def claim(address: str, what: str) -> int:
    """Lock a serial port against other programs and return a file, whose closing gives it free.

    Args:
        address: Path of the port.
        what: Name of what is there for messages, such as "servo bus".

    Raises:
        DeviceFault: The port does not exist, may not be used, or is in use by another program; the message says what to
            do.
    """
    try:
        file = os.open(address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except PermissionError as err:
        group = group_of(address) if os.path.exists(address) else "dialout"
        raise DeviceFault(
            f"You may not use the {what} at {address}: {err.strerror}. Join the port's group and log in again: "
            f"sudo usermod -aG {group} $USER."
        ) from err
    except OSError as err:
        if err.errno == errno.EBUSY:  # the other program has opened it for itself alone
            raise DeviceFault(f"The {what} at {address} is in use by {_holder(address)}; end it first.") from err
        raise DeviceFault(
            f"There is no {what} at {address}: {err.strerror}. Check the cable. Plugged in: "
            f"{'; '.join(f'{one}, /dev/{port_of(one)}' for one in _with_ports()) or 'no serial port on USB'}."
        ) from err
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as err:
        os.close(file)
        raise DeviceFault(f"The {what} at {address} is in use by {_holder(address)}; end it first.") from err
    return file


def group_of(path: str) -> str:
    """Return the group of a file: its name, or its number where it has none, as in a container."""
    try:
        return Path(path).group()
    except KeyError:
        return str(os.stat(path).st_gid)


def _with_ports() -> list[UsbDevice]:
    return [one for one in usb_devices() if port_of(one)]


def _holder(address: str) -> str:
    """Return the process that has locked a port, or else those that have it open, if the system reveals them."""
    wanted = str(os.stat(address).st_ino)
    for line in Path("/proc/locks").read_text().splitlines():
        words = line.split()
        if words[1] == "FLOCK" and words[5].rpartition(":")[2] == wanted:
            return program_of(words[4])
    return ", ".join(holders(os.path.realpath(address))) or "another program"
