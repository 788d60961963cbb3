"""Devices whose driver runs in a separate process, the host; starting, finding and stopping hosts.

A host serves the devices at one address. It listens on a Unix socket in a folder that only its user can enter; commands
and measurements then go through memory that the program and the host share (`core/src/host_memory.hpp`).
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rcs._core import HOST_MEMORY, INTERFACE_VERSION, HostedArm, HostedGripper, HostedHand
from rcs.devices import Arm, Gripper, Hand
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.driver import Driver, HostTimes

LONGEST_PATH = 107
"""Most bytes of the path of a Unix socket (man 7 unix)."""
START = 10.0
"""Timeout for the start of a host [s]; importing this package and NumPy takes 0.3 s on an idle machine."""
STOP_TIME = 2.5
"""Timeout for a host that is to stop its devices [s]: it answers when they stand, after 1 s of braking at most."""
GREETING = b"here" + struct.pack("=2I", INTERFACE_VERSION, HOST_MEMORY)
"""A host's first message on a socket, with the layout of the shared memory."""
DEVICE, STOP, STOPPED = b"open", b"stop", b"held"
"""The next ones, which precede the records; all have the same length."""
FOLDER = "RCS_HOSTS"
"""Environment variable that overrides the folder of the hosts' sockets."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """The address that a host serves."""

    driver: str
    """Name of the driver, as in a site."""
    address: str
    """Address in the form that the driver takes."""
    library: str = ""
    """Value of `Driver.library`."""

    @property
    def socket(self) -> Path:
        """Path of the host's socket.

        Raises:
            InvalidSetup: The folder cannot be used, or its path is too long.
        """
        text = f"{self.driver}:{self.address}" + (f":{self.library}" if self.library else "")
        readable = re.sub(r"[^\w.-]", "_", text)[:24]
        path = folder() / f"{readable}-{hashlib.sha256(text.encode()).hexdigest()[:8]}.sock"
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise InvalidSetup(f"The path {path} is too long for a socket; name a shorter folder in {FOLDER}.")
        return path

    def __str__(self) -> str:
        return f"{self.driver}:{self.address}" if self.address else self.driver


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A program's request to open a device in a host."""

    place: Place
    kind: str
    """`arm`, `gripper` or `hand`."""
    about: Any
    """Description of the device."""
    options: Mapping[str, Any]
    path: tuple[str, ...]
    """Module search path of the program."""


def folder() -> Path:
    """Return the folder of the sockets, which only this user can enter.

    Raises:
        InvalidSetup: It cannot be made, or another user owns it or may enter it.
    """
    # The same for every program of a user: /run/user is there only while somebody is logged in, and TMPDIR may differ.
    path = Path(os.environ.get(FOLDER) or Path(os.sep, "tmp", f"rcs-{os.getuid()}"))
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as err:
        raise InvalidSetup(f"The folder {path} cannot be made: {err}; name another one in {FOLDER}.") from err
    about = path.lstat()
    if about.st_uid != os.getuid() or about.st_mode & 0o077:
        raise InvalidSetup(
            f"{path} belongs to, or is open to, another user; remove it, or name another folder in {FOLDER}."
        )
    return path


def is_hosted(driver: Driver, options: Mapping[str, Any]) -> bool:
    """Return True if devices of a driver run in a host, by the option `host` or else the driver's default.

    Raises:
        InvalidSetup: The option is neither true nor false.
    """
    host = options.get("host", driver.hosted)
    if not isinstance(host, bool):
        raise InvalidSetup(f"The option 'host' is {host!r}; valid is true or false.")
    return host


def hosted(
    device: Arm | Gripper | Hand, place: Place, about: Any, options: Mapping[str, Any], times: HostTimes
) -> HostedArm | HostedGripper | HostedHand:
    """Return a device that runs in a host; opening it finds or starts the host.

    Args:
        device: The driver's device in this process, which serves as the model and is never opened.
        place: Driver and address.
        about: Description of the device.
        options: The driver's options.
        times: Time limits of calls.
    """
    kind = "arm" if isinstance(device, Arm) else "gripper" if isinstance(device, Gripper) else "hand"
    wanted = Wanted(place=place, kind=kind, about=about, options=dict(options), path=tuple(sys.path))
    connect = _connector(wanted, device.name, times)
    if isinstance(device, Arm):
        return HostedArm(device, connect, times.answer)
    if isinstance(device, Gripper):
        return HostedGripper(device, connect, times.answer)
    return HostedHand(device, connect, times.answer)


def start(place: Place, *, stays: bool = False) -> subprocess.Popen[bytes]:
    """Start a host in a session of its own, so that Ctrl-C in the program's terminal does not reach it.

    Args:
        place: Driver and address.
        stays: Keep it running while no program uses it, until this process ends.
    """
    _started[:] = [process for process in _started if process.poll() is None]
    words = [sys.executable, "-P", "-m", "rcs.hardware.host", place.driver, place.address, place.library]
    words += [str(os.getpid()), *["--stay"] * stays]
    # Output of a vendor's library must not mix with the program's standard output.
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=2, start_new_session=True)
    _started.append(process)
    return process


@contextmanager
def start_all(places: Iterable[Place]) -> Generator[dict[Place, subprocess.Popen[bytes]]]:
    """Start hosts that stay, yield their processes once all of them listen, and end them on exit.

    Raises:
        DeviceFault: A host does not start, or one already serves its address.
    """
    hosts: dict[Place, subprocess.Popen[bytes]] = {}
    try:
        for place in places:
            hosts[place] = start(place, stays=True)
        limit = time.monotonic() + START
        for place, process in hosts.items():
            while (connection := call(place.socket)) is None or peer(connection) != process.pid:
                if process.poll() == IN_USE:
                    raise DeviceFault(f"{place} already has a host, started by another `rcs host` or by a program.")
                if process.returncode is not None or time.monotonic() > limit:
                    raise DeviceFault(f"The host of {place} did not start; see its output above.")
                time.sleep(0.005)
            connection.close()
        yield hosts
    finally:
        for process in hosts.values():
            process.terminate()
        for process in hosts.values():
            try:
                process.wait(2 * HostTimes.close)
            except subprocess.TimeoutExpired:
                process.kill()


_started: list[subprocess.Popen[bytes]] = []
"""Hosts that this process has started; starting another one reaps those that have ended."""


def call(path: Path) -> socket.socket | None:
    """Return a connection to the host at a socket; None if no host runs there.

    Raises:
        DeviceFault: The host does not answer, or runs another version.
    """
    connection, greeting = socket.socket(socket.AF_UNIX), b""
    connection.settimeout(HostTimes.close + 0.5)  # it may be closing its device before it ends
    try:
        connection.connect(str(path))
        greeting = connection.recv(len(GREETING))
    except TimeoutError as err:
        raise DeviceFault(
            f"The host at {path} (process {peer(connection)}) does not answer; end it by `rcs stop` and check its "
            "device."
        ) from err
    except OSError:
        pass
    if greeting == GREETING:
        return connection
    with connection:
        if not greeting:
            return None
        raise DeviceFault(
            f"The host at {path} (process {peer(connection)}) runs another version of the device interfaces; end "
            "`rcs host`, or the program that started it, and start it anew."
        )


def peer(connection: socket.socket) -> int:
    """Return the process ID, from the kernel, of the peer of a Unix socket; 0 if unknown."""
    with suppress(OSError):
        size = struct.calcsize("3i")
        return int(struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))[0])
    return 0


def _kill(process: int) -> None:
    """Kill a host that hangs, since it might later move its device; 0 and 1 are no hosts, but whole groups."""
    if process > 1:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)


def stop_hosts() -> dict[str, str]:
    """Hold the devices of all hosts of this user and put them at fault; return the outcome by host name.

    A host that does not answer within `STOP_TIME` is killed.
    """
    paths = sorted(folder().glob("*.sock"))
    with ThreadPoolExecutor(max(len(paths), 1)) as pool:  # no host waits for one that does not answer
        return {path.stem: outcome for path, outcome in zip(paths, pool.map(_stop, paths), strict=True) if outcome}


def _stop(path: Path) -> str:
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(STOP_TIME)
    with connection:
        try:
            connection.connect(str(path))
        except OSError:
            return ""  # a host that was killed leaves its socket behind
        process = peer(connection)
        with suppress(OSError):
            connection.sendall(STOP)
            while answer := connection.recv(64):
                if STOPPED in answer:
                    return f"holds (process {process})"
        _kill(process)
        return f"did not answer and was killed (process {process}); check its device"


def _connector(wanted: Wanted, name: str, times: HostTimes) -> Callable[[], tuple[int, int, int]]:
    def connect() -> tuple[int, int, int]:
        connection = _reach(wanted.place)
        process = peer(connection)
        memory = os.memfd_create("rcs host", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.ftruncate(memory, HOST_MEMORY)
            fcntl.fcntl(memory, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
            socket.send_fds(connection, [DEVICE], [memory])
            _ask(connection, process, wanted, name, times)
        except BaseException:
            os.close(memory)
            connection.close()
            raise
        connection.setblocking(True)
        return memory, connection.detach(), process

    return connect


def _reach(place: Place) -> socket.socket:
    """Return a connection to the host of a place, starting it if necessary.

    Raises:
        DeviceFault: The host does not start.
    """
    path, process = place.socket, None
    limit = time.monotonic() + START
    while (connection := call(path)) is None:
        if process is None or process.poll() is not None:
            if process is not None and process.returncode not in (0, IN_USE):
                raise DeviceFault(
                    f"The host of {place} did not start (exit code {process.returncode}); see its output above."
                )
            process = start(place)
        if time.monotonic() > limit:
            process.kill()
            raise DeviceFault(f"The host of {place} did not start within {START:g} s; is the machine too busy?")
        time.sleep(0.005)
    return connection


IN_USE = 3
"""Exit code of a host that finds another one at its address."""


def _ask(connection: socket.socket, process: int, wanted: Wanted, name: str, times: HostTimes) -> None:
    """Open the device in the host; raise the driver's exception from there."""
    records = Connection(os.dup(connection.fileno()))
    try:
        records.send(wanted)
        if not records.poll(times.open):
            _kill(process)
            raise DeviceFault(
                f"{name}: opening {wanted.place} did not end within {times.open:g} s, and its host (process {process}) "
                "was killed. Check the address, the cable, and that the device is switched on."
            )
        answer = records.recv()
    except (EOFError, OSError) as err:
        raise DeviceFault(f"{name}: the host (process {process}) of {wanted.place} ended while opening it.") from err
    finally:
        records.close()
    if isinstance(answer, Exception):
        raise answer
