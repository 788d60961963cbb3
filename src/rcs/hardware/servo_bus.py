"""A bus of Feetech servos on a serial port, over the vendor's library.

The library takes whatever arrives next for the answer to its request, with success: after one late packet, every
request would get the answer of the one before. So waiting input is dropped before each request, reads that repeat ask
for a different number of bytes each time, and an answer counts only if it has the servo and the length that were asked
for.
"""

from __future__ import annotations

import fcntl
import logging
import os
import select
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rcs.errors import DeviceFault
from rcs.extras import package_of

BAUD = 1_000_000
TIMEOUT = 0.09
"""How long servos may not answer before they count as lost [s]; adapters keep what they have got for up to 16 ms."""
PATIENCE = 1 / 3
"""Part of this time after which the last servo that was asked is asked again."""
LENGTHS = 8
"""How many lengths reads that repeat go through, so that a late answer is known by its length."""

_log = logging.getLogger(__name__)


class ServoBus:
    """Reads and writes registers of servos; for one thread at a time."""

    def __init__(self, address: str, names: Mapping[int, str], timeout: float = TIMEOUT) -> None:
        """Describe the bus; nothing is opened.

        Args:
            address: Path of the serial port.
            names: The servos by number, and what they are called in messages.
            timeout: How long servos may not answer before they count as lost [s].
        """
        self.address = address
        self.names = names
        self.timeout = timeout
        self.is_lost = False
        """Whether the last request was not answered at all; then the next one is not repeated."""
        self.failures = 0
        """Requests that had to be repeated."""
        self._turn = 0
        self._port: Any = None
        self._packets: Any = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._port is not None

    def open(self) -> None:
        """Open the port.

        Raises:
            MissingDependency: The vendor's library is not installed.
            DeviceFault: There is no such port, it is not permitted, or another program has it.
        """
        sdk = package_of("so101", "scservo_sdk", "An SO101 needs")
        port = sdk.PortHandler(self.address)
        try:
            port.setBaudRate(BAUD)
            fcntl.flock(port.ser.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except PermissionError as err:
            raise self._not_permitted(err) from err
        except BlockingIOError as err:
            port.closePort()
            raise DeviceFault(
                f"The servo bus at {self.address} is in use by {_holder(self.address)}; end that first."
            ) from err
        except OSError as err:  # pyserial's is one
            if getattr(err, "errno", None) == 13:
                raise self._not_permitted(err) from err
            raise DeviceFault(
                f"There is no servo bus at {self.address}: {err}. Look at the cable, and for the port: ls /dev/tty*"
            ) from err
        self._port, self._packets = port, sdk.PacketHandler(0)

    def close(self) -> None:
        """Close the port; closing twice is harmless."""
        if self._port is not None:
            self._port.closePort()
            self._port = None

    def read(self, servos: Sequence[int], first: int, count: int) -> dict[int, tuple[int, bytes]]:
        """Return errors and registers of servos.

        Args:
            servos: Their numbers.
            first: First register.
            count: Number of registers; some more may be asked for.

        Raises:
            DeviceFault: Some servos do not answer; the message has their names.
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
        """Write a register and wait until the servo says that it has it.

        Args:
            servo: Its number.
            register: First byte of the register.
            value: What to write.
            size: Number of bytes; registers follow each other.

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
        """Write a register of several servos at once; no servo answers that.

        Args:
            register: First byte of the register.
            values: What to write, by servo.
            size: Number of bytes.

        Raises:
            DeviceFault: The port is gone.
        """
        self._begin()
        words = [byte for servo, value in values.items() for byte in (servo, *value.to_bytes(size, "little"))]
        self._packets.syncWriteTxOnly(self._port, register, size, words, len(words))

    def _begin(self) -> None:
        """Drop what an earlier request has left."""
        if self._port is None:
            raise DeviceFault(f"The servo bus at {self.address} is closed.")
        try:
            self._port.ser.reset_input_buffer()
        except OSError as err:
            raise self._gone(err) from err
        self._port.is_using = False

    def _answers(self, servos: Sequence[int], length: int) -> dict[int, tuple[int, bytes]]:
        """Return errors and values of the servos that answer with this many values in time."""
        found: dict[int, tuple[int, bytes]] = {}
        deadline = time.monotonic() + self.timeout * PATIENCE
        expected = (length + 6) * len(servos)
        try:
            while servos[-1] not in found:  # they answer in turn: who comes before the last one and is missing was lost
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
        """Wait for some bytes without keeping the interpreter busy."""
        while (rest := deadline - time.monotonic()) > 0:
            if self._port.getBytesAvailable() >= bytes_:
                return
            select.select([self._port.ser.fileno()], [], [], rest)
            time.sleep(min(2e-4, max(rest, 0.0)))

    def _gone(self, err: OSError) -> DeviceFault:
        return DeviceFault(f"The servo bus at {self.address} is gone: {err}. Look at the USB cable.")

    def _not_permitted(self, err: OSError) -> DeviceFault:
        return DeviceFault(
            f"The servo bus at {self.address} is not permitted: {err}. Join the group of the port and log in anew: "
            "sudo usermod -aG dialout $USER."
        )


class _Request:
    """One request, until it is answered or its time is over."""

    def __init__(self, bus: ServoBus, servos: Sequence[int]) -> None:
        self.missing = servos
        self._bus, self._asked, self._begin = bus, 0, time.monotonic()

    def goes_on(self) -> bool:
        """Whether to ask, once more or for the first time."""
        self._asked += 1
        if self._asked == 1:
            return True
        self._bus.failures += 1
        _log.debug("servo bus %s: no answer of %s to request %d", self._bus.address, self.missing, self._asked - 1)
        return not self._bus.is_lost and time.monotonic() - self._begin < self._bus.timeout

    def lost(self) -> DeviceFault:
        self._bus.is_lost = True
        names = self._bus.names
        times = "once" if self._asked == 2 else f"{self._asked - 1} times"
        some = ", ".join(f"{names[servo]} (servo {servo})" for servo in self.missing)
        who = "none of the servos answers" if len(self.missing) == len(names) else f"no answer of {some}"
        return DeviceFault(
            f"{who} on the servo bus at {self._bus.address}, asked {times} in "
            f"{1e3 * (time.monotonic() - self._begin):.0f} ms; look at the power supply, and at the cable before the "
            "first that is missing"
        )


def _holder(address: str) -> str:
    """Return who has locked a port, as far as the system tells."""
    wanted = str(os.stat(address).st_ino)
    for line in Path("/proc/locks").read_text().splitlines():
        words = line.split()
        if words[1] == "FLOCK" and words[5].rpartition(":")[2] == wanted:
            try:
                program = Path(f"/proc/{words[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
            except OSError:
                program = ""
            return f"process {words[4]} ({program})" if program else f"process {words[4]}"
    return "another program"


def signed(value: int, bit: int) -> int:
    """Return the number that a servo stores as an amount and a bit for its sign."""
    amount = value & ((1 << bit) - 1)
    return -amount if value >> bit & 1 else amount
