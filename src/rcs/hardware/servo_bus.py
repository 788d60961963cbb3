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
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rcs.errors import DeviceFault
from rcs.extras import package_of

BAUD = 1_000_000
TIMEOUT = 0.09
"""How long servos may not answer before they count as lost [s]; adapters keep what they have got for up to 16 ms."""
ATTEMPTS = 3
"""Requests that are made in this time."""
LENGTHS = 8
"""How many lengths reads that repeat go through, so that a late answer is known by its length."""

_log = logging.getLogger(__name__)


class ServoBus:
    """Reads and writes registers of servos; every call is safe from any thread, and one at a time."""

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
        self.failures = 0
        """Requests that had to be repeated."""
        self.lock = threading.RLock()
        """Held by every call; hold it around several that belong together."""
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
        with self.lock:
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
        with self.lock:
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
        missing: Sequence[int] = servos
        begin = time.monotonic()
        with self.lock:
            for attempt in range(ATTEMPTS):
                self._turn = (self._turn + 1) % LENGTHS
                length = count + self._turn
                self._begin()
                sent = self._packets.syncReadTx(self._port, first, length, list(servos), len(servos))
                if sent == 0:
                    found = self._answers(servos, length)
                    if len(found) == len(servos):
                        return {servo: (errors, values[:count]) for servo, (errors, values) in found.items()}
                    missing = [servo for servo in servos if servo not in found]
                self._count_failure(attempt, missing)
        raise self._lost(missing, begin)

    def write(self, servo: int, register: int, value: int, size: int) -> None:
        """Write a register and wait until the servo says that it has it.

        Args:
            servo: Its number.
            register: First byte of the register.
            value: What to write.
            size: Number of bytes, 1 or 2.

        Raises:
            DeviceFault: The servo does not answer.
        """
        begin = time.monotonic()
        with self.lock:
            for attempt in range(ATTEMPTS):
                self._begin()
                packet = [0, 0, servo, size + 3, 3, register, *value.to_bytes(size, "little"), 0]
                if self._packets.txPacket(self._port, packet) == 0 and self._answers([servo], 0):
                    return
                self._count_failure(attempt, [servo])
        raise self._lost([servo], begin)

    def write_all(self, register: int, values: Mapping[int, int], size: int = 2) -> None:
        """Write a register of several servos at once; no servo answers that.

        Args:
            register: First byte of the register.
            values: What to write, by servo.
            size: Number of bytes.

        Raises:
            DeviceFault: The port is gone.
        """
        with self.lock:
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
        deadline = time.monotonic() + self.timeout / ATTEMPTS
        expected = (length + 6) * len(servos)
        try:
            while len(found) < len(servos):
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

    def _count_failure(self, attempt: int, servos: Sequence[int]) -> None:
        self.failures += 1
        _log.debug("servo bus %s: request %d, no answer of %s", self.address, attempt + 1, servos)

    def _lost(self, servos: Sequence[int], begin: float) -> DeviceFault:
        names = ", ".join(f"{self.names[servo]} (servo {servo})" for servo in servos)
        who = "none of the servos answers" if len(servos) == len(self.names) else f"no answer of {names}"
        passed = 1e3 * (time.monotonic() - begin)
        return DeviceFault(
            f"{who} on the servo bus at {self.address}, asked {ATTEMPTS} times in {passed:.0f} ms; look at the power "
            "supply and at the cable before the first that is missing."
        )

    def _gone(self, err: OSError) -> DeviceFault:
        return DeviceFault(f"The servo bus at {self.address} is gone: {err}. Look at the USB cable.")

    def _not_permitted(self, err: OSError) -> DeviceFault:
        return DeviceFault(
            f"The servo bus at {self.address} is not permitted: {err}. Join the group of the port and log in anew: "
            "sudo usermod -aG dialout $USER."
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
