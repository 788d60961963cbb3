"""Files of the kernel through which input devices are read, with errors that have the remedy."""

from __future__ import annotations

import errno
import fcntl
import os
import select
from pathlib import Path

from rcs_data.files.closing import Closing

from rcs.errors import DeviceFault

GRAB = 0x40044590
"""EVIOCGRAB of linux/input.h: keep the events of a device from all other programs."""
LARGEST = 4096
"""Most bytes of one read."""


class DeviceFile(Closing):
    """An open file of a device, used by one thread at a time."""

    def __init__(self, path: str, what: str, match: str, *, alone: bool = False) -> None:
        """Open the file for reading.

        Args:
            path: Its path, such as `/dev/hidraw0`.
            what: The device in messages, such as "SpaceMouse".
            match: The condition of a udev rule that is true for the device.
            alone: Keep the input from all other programs; for files of `/dev/input`.

        Raises:
            DeviceFault: It is not there, may not be opened, or another program keeps it to itself.
        """
        self.path, self._what = path, what
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError as err:
            raise DeviceFault(f"You may not read the {what} at {path}. Allow it: {udev_rule(match, what)}") from err
        except OSError as err:
            raise DeviceFault(f"There is no {what} at {path}: {err.strerror}. Plug it in, or give its path.") from err
        try:
            if alone:
                fcntl.ioctl(self._file, GRAB, 1)
        except OSError as err:
            self.close()
            if err.errno == errno.EBUSY:
                raise DeviceFault(f"The {what} at {path} is in use by another program; end that first.") from err
            raise DeviceFault(f"{path} is no {what}: {err.strerror}. Give the path of one.") from err

    def read(self, seconds: float) -> bytes:
        """Return what has come, or nothing after a time without input [s].

        Raises:
            DeviceFault: The device is gone.
        """
        if not select.select([self._file], [], [], seconds)[0]:
            return b""
        try:
            found = os.read(self._file, LARGEST)
        except OSError as err:
            raise self._gone(err.strerror or str(err)) from err
        if not found:
            raise self._gone("end of file")
        return found

    def close(self) -> None:
        """Close the file."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _gone(self, why: str) -> DeviceFault:
        return DeviceFault(f"The {self._what} at {self.path} is gone: {why}. Plug it in again, and start anew.")


def udev_rule(match: str, what: str) -> str:
    """Return commands that let the person at the screen use a device.

    Args:
        match: The condition of the rule.
        what: The device, which names the file.
    """
    file = f"/etc/udev/rules.d/70-{what.lower().replace(' ', '-')}.rules"
    return (
        f"""echo '{match}, TAG+="uaccess"' | sudo tee {file}; """
        "sudo udevadm control --reload; sudo udevadm trigger; then plug the device in again."
    )


def one_of(what: str, found: dict[str, str], missing: str) -> str:
    """Return the only path.

    Args:
        what: The device in messages.
        found: Names of the devices by path.
        missing: Words on what to do if there is none.

    Raises:
        DeviceFault: There is none, or more than one.
    """
    if len(found) == 1:
        return next(iter(found))
    if not found:
        raise DeviceFault(f"There is no {what}. {missing}")
    several = ", ".join(f"{path} ({name})" for path, name in found.items())
    raise DeviceFault(f"There are {len(found)} devices of the kind {what}: {several}. Give the path of one.")


def line_of(path: Path) -> str:
    """Return the text of a small file of the kernel; empty if it cannot be read."""
    try:
        return path.read_text("utf-8", "replace").strip()
    except OSError:
        return ""
