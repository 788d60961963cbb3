"""A bus of Feetech servos on a serial port, through the vendor's library.

The library accepts whatever arrives next as the answer to its request: after one late packet, every request would get
the answer to the previous one. Therefore pending input is dropped before each request, repeated reads each request a
different number of bytes, and an answer counts only if its servo and length match the request.
"""

from __future__ import annotations

import logging
import os
import select
import termios
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rcs.errors import DeviceFault
from rcs.extras import package_of
from rcs.hardware.serial_port import claim, port_at

BAUD = 1_000_000
TIMEOUT = 0.09
"""Time without an answer after which servos count as lost [s]; adapters buffer input for up to 16 ms."""
PATIENCE = 1 / 3
"""Fraction of the timeout after which the last servo of a request is queried again."""
MUTE = 0.05
"""Time for which a bus on which no servo answered is not queried again, so that devices that share it do not wait one
after the other until the fault is known [s]."""
LENGTHS = 8
"""Number of different lengths of repeated reads, which identify late answers."""

_log = logging.getLogger(__name__)


class ServoBus:
    """Reads and writes servo registers; use it from one thread at a time."""

    def __init__(self, address: str, names: Mapping[int, str], timeout: float = TIMEOUT) -> None:
        """Create the bus; `open` opens the port.

        Args:
            address: Path of the serial port, or serial number or place of its USB device.
            names: Names of the servos for messages, by number.
            timeout: Time without an answer after which servos count as lost [s].
        """
        self.address = address
        self.names = names
        self.timeout = timeout
        self.is_lost = False
        """True if no servo answered the last request; the next one is then not repeated."""
        self.is_gone = False
        """True if the port has disappeared; closing and opening the bus connects it again."""
        self.mute_until = 0.0
        """Time until which requests fail at once, because no servo answered the last one [s, monotonic]."""
        self.mute_text = ""
        """The reason that they give."""
        self.failures = 0
        """Number of repeated requests."""
        self._turn = 0
        self._port: Any = None
        self._claimed = -1
        self._packets: Any = None

    @property
    def is_open(self) -> bool:
        """True while the port is open."""
        return self._port is not None

    def open(self) -> None:
        """Open the port.

        Raises:
            MissingDependency: The vendor's library is not installed.
            InvalidSetup: No port has the serial number or place.
            DeviceFault: The port does not exist, may not be used, or is in use by another program.
        """
        sdk = package_of("so101", "scservo_sdk", "An SO101 needs")
        path = port_at(self.address, "servo bus")
        claimed = claim(path, "servo bus")
        port = sdk.PortHandler(path)
        try:
            port.setBaudRate(BAUD)
        except (OSError, termios.error) as err:  # includes pyserial's exceptions
            os.close(claimed)
            raise DeviceFault(f"The servo bus at {self.address} cannot be opened: {err}. Check the USB cable.") from err
        self._claimed, self.is_gone = claimed, False
        self._port, self._packets = port, sdk.PacketHandler(0)

    def close(self) -> None:
        """Close the port; closing twice is harmless."""
        if self._port is not None:
            self._port.closePort()
            os.close(self._claimed)
            self._port = None

    def read(self, servos: Sequence[int], first: int, count: int) -> dict[int, tuple[int, bytes]]:
        """Return error bits and register values of servos.

        Args:
            servos: Their numbers.
            first: First register.
            count: Number of registers; the request may read a few more.

        Raises:
            DeviceFault: Some servos do not answer; the message names them.
        """
        request = _Request(self, servos)
        while request.goes_on():
            self._turn = (self._turn + 1) % LENGTHS
            length = count + self._turn
            self._begin()
            if self._packets.syncReadTx(self._port, first, length, list(servos), len(servos)) == 0:
                found = self._answers(servos, length)
                if len(found) == len(servos):
                    self.is_lost = False
                    return {servo: (errors, values[:count]) for servo, (errors, values) in found.items()}
                request.missing = [servo for servo in servos if servo not in found]
        raise request.lost()

    def write(self, servo: int, register: int, value: int, size: int) -> None:
        """Write a register and wait for the servo's acknowledgement.

        Args:
            servo: Its number.
            register: First byte of the register.
            value: Value to write.
            size: Number of bytes, from the register on.

        Raises:
            DeviceFault: The servo does not answer.
        """
        request = _Request(self, [servo])
        while request.goes_on():
            self._begin()
            packet = [0, 0, servo, size + 3, 3, register, *value.to_bytes(size, "little"), 0]
            if self._packets.txPacket(self._port, packet) == 0 and self._answers([servo], 0):
                self.is_lost = False
                return
        raise request.lost()

    def write_all(self, register: int, values: Mapping[int, int], size: int = 2) -> None:
        """Write a register of several servos at once, without acknowledgement.

        Args:
            register: First byte of the register.
            values: Values to write, by servo.
            size: Number of bytes.

        Raises:
            DeviceFault: The port has disappeared.
        """
        self._begin()
        words = [byte for servo, value in values.items() for byte in (servo, *value.to_bytes(size, "little"))]
        try:
            self._packets.syncWriteTxOnly(self._port, register, size, words, len(words))
        except OSError as err:
            raise self._gone(err) from err

    def _begin(self) -> None:
        """Drop input left by an earlier request."""
        if self._port is None:
            raise DeviceFault(f"The servo bus at {self.address} is closed.")
        try:
            self._port.ser.reset_input_buffer()
        except (OSError, termios.error) as err:  # the latter is no OSError
            raise self._gone(err) from err
        self._port.is_using = False

    def _answers(self, servos: Sequence[int], length: int) -> dict[int, tuple[int, bytes]]:
        """Return errors and values of the servos that answer in time with this many values."""
        found: dict[int, tuple[int, bytes]] = {}
        deadline = time.monotonic() + self.timeout * PATIENCE
        expected = (length + 6) * len(servos)
        try:
            while servos[-1] not in found:  # they answer in order: one missing before the last is lost
                self._wait(expected - (length + 6) * len(found), deadline)
                self._port.setPacketTimeoutMillis(0.0)
                packet, result = self._packets.rxPacket(self._port)
                if result == 0:
                    if packet[2] in servos and packet[3] == length + 2:
                        found[packet[2]] = packet[4], bytes(packet[5 : 5 + length])
                elif time.monotonic() >= deadline:
                    break
        except OSError as err:
            raise self._gone(err) from err
        return found

    def _wait(self, bytes_: int, deadline: float) -> None:
        """Wait for a number of bytes without holding the GIL."""
        while (rest := deadline - time.monotonic()) > 0:
            if self._port.getBytesAvailable() >= bytes_:
                return
            select.select([self._port.ser.fileno()], [], [], rest)
            time.sleep(min(2e-4, max(rest, 0.0)))

    def _gone(self, err: Exception) -> DeviceFault:
        self.is_gone = True
        return DeviceFault(f"The servo bus at {self.address} has disappeared: {err}. Check the USB cable.")


class _Request:
    """A request until it is answered or times out."""

    def __init__(self, bus: ServoBus, servos: Sequence[int]) -> None:
        self.missing = servos
        self._bus, self._asked, self._begin = bus, 0, time.monotonic()

    def goes_on(self) -> bool:
        """Return True if the request should be sent, for the first time or again."""
        self._asked += 1
        if self._asked == 1:
            if self._begin < self._bus.mute_until:
                raise DeviceFault(self._bus.mute_text)
            return True
        self._bus.failures += 1
        _log.debug("servo bus %s: no answer from %s to request %d", self._bus.address, self.missing, self._asked - 1)
        return not self._bus.is_lost and time.monotonic() - self._begin < self._bus.timeout

    def lost(self) -> DeviceFault:
        self._bus.is_lost = True
        names = self._bus.names
        times = "once" if self._asked == 2 else f"{self._asked - 1} times"
        some = ", ".join(f"{names[servo]} (servo {servo})" for servo in self.missing)
        is_mute = len(self.missing) == len(names)
        who = "none of the servos answers" if is_mute else f"no answer from {some}"
        text = (
            f"{who} on the servo bus at {self._bus.address}, queried {times} in "
            f"{1e3 * (time.monotonic() - self._begin):.0f} ms; check the power supply and the cable to the first "
            "missing servo"
        )
        if is_mute:
            self._bus.mute_until, self._bus.mute_text = time.monotonic() + MUTE, text
        return DeviceFault(text)


def signed(value: int, bit: int) -> int:
    """Return the number that a servo stores as a magnitude and a sign bit."""
    amount = value & ((1 << bit) - 1)
    return -amount if value >> bit & 1 else amount
