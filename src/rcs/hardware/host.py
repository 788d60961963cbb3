"""The host: a process that runs a driver and serves the devices at one address to one program at a time.

A program or `rcs host` starts it as `python -m rcs.hardware.host DRIVER ADDRESS LIBRARY STARTER [--stay]`. It ends
together with its starter, whose process ID that is, on SIGTERM, and, without `--stay`, when no program uses it. Before
it ends, its devices hold.
"""

from __future__ import annotations

import contextlib
import faulthandler
import fcntl
import os
import select
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from rcs._core import HostCall, HostDesk, HostOutcome, HostRequest
from rcs.devices import Arm, Gripper, Hand, StreamedArm, stop_all
from rcs.errors import DeviceFault, InvalidAction, RcsError, WrongOrder
from rcs.hardware.driver import Driver, HostTimes, driver_named
from rcs.hardware.hosted import GREETING, IN_USE, STOP, STOPPED, Place, Wanted, peer
from rcs.hardware.programs import program_of
from rcs.spatial import Pose

FAILED_REST = 0.05
"""Pause after a failed measurement [s]."""
LETTING_GO = 0.5
"""Time a program waits for another one that is closing the device [s]."""


class Host:
    """Serves the devices at one address, with a thread for each."""

    def __init__(self, place: Place, *, stays: bool) -> None:
        """Serve a place; with `stays`, keep running when no program uses it."""
        self.place = place
        self._stays = stays
        self._driver: Driver | None = None
        self._lock = threading.Condition()
        self._users: dict[str, int] = {}  # process of the program that uses each kind of device
        self._answering = 0
        self._delays: list[float] = []  # time limits of calls under way that may hold the GIL [s]
        self._desks: list[HostDesk] = []
        self._threads: list[threading.Thread] = []
        self._ends = os.eventfd(0)  # signalled by each thread that has finished answering
        self._is_ending = False

    def run(self, listener: socket.socket, starter: int) -> None:
        """Serve programs until the host ends, or the process of the pidfd `starter` does."""
        try:
            while True:
                ready, _, _ = select.select([listener, starter, self._ends], [], [])
                if starter in ready:
                    return
                if self._ends in ready:
                    os.eventfd_read(self._ends)
                    if self._answering == 0:
                        return
                if listener not in ready:
                    continue
                connection, _ = listener.accept()
                with self._lock:
                    self._answering += 1
                thread = threading.Thread(target=self._answer, args=(connection,), name="rcs host", daemon=True)
                self._threads = [*(one for one in self._threads if one.is_alive()), thread]
                thread.start()
        finally:
            self._is_ending = True
            stop_all("its host ends")
            for thread in self._threads:
                thread.join(HostTimes.close)

    def _answer(self, connection: socket.socket) -> None:
        try:
            self._converse(connection)
        finally:
            with self._lock:
                self._answering -= 1
            if not self._stays:
                os.eventfd_write(self._ends, 1)

    def _converse(self, connection: socket.socket) -> None:
        """Execute the request of the other side."""
        with connection:
            process = peer(connection)
            try:
                connection.sendall(GREETING)
                word, files, _, _ = socket.recv_fds(connection, len(STOP), 1)
            except OSError:
                return
            if word == STOP:
                stop_all(f"`rcs stop`, process {process}")
                with contextlib.suppress(OSError):
                    connection.sendall(STOPPED)
            if not files:
                return
            records = Connection(os.dup(connection.fileno()))
            try:
                self._serve(records, files[0], process)
            except (EOFError, OSError):
                pass  # the program ended before it had its device
            finally:
                records.close()
                os.close(files[0])

    def _serve(self, records: Connection, memory: int, process: int) -> None:
        wanted: Wanted = records.recv()
        try:
            with self._claim(wanted.kind, process):
                device, times = self._make(wanted)
                with self._others_wait("opening", times.open):
                    device.open()
                with device:
                    desk = HostDesk(memory, records.fileno(), process, device)
                    if not _measure(device, desk, self._limit(times)):
                        raise DeviceFault(f"{device.name}: {device.fault}")
                    records.send(None)
                    with self._listed(desk):
                        self._work(device, desk, times)
        except Exception as err:  # noqa: BLE001  the program raises it
            records.send(err if isinstance(err, RcsError) else DeviceFault(f"{wanted.place}: {in_words(err)}"))

    @contextmanager
    def _claim(self, kind: str, process: int) -> Generator[None]:
        """Reserve a device for one program.

        Raises:
            DeviceFault: Another program uses it.
        """

        def others() -> list[int]:
            return [user for other, user in self._users.items() if user != process or other == kind]

        with self._lock:
            if not self._lock.wait_for(lambda: not others(), LETTING_GO):
                user = others()[0]
                raise DeviceFault(f"{self.place} is in use by {program_of(user)}; end it first.")
            self._users[kind] = process
        try:
            yield
        finally:
            with self._lock:
                del self._users[kind]
                self._lock.notify_all()

    @contextmanager
    def _others_wait(self, call: str, seconds: float) -> Generator[None]:
        """Extend the time limits of the other devices during a call that may hold the GIL."""
        self._delays.append(seconds)
        for desk in list(self._desks):
            desk.promise(f"{call} of another device", seconds)
        try:
            yield
        finally:
            self._delays.remove(seconds)

    def _limit(self, times: HostTimes) -> float:
        """Return the time limit of the next call [s]."""
        return max([times.answer, *self._delays])

    @contextmanager
    def _listed(self, desk: HostDesk) -> Generator[None]:
        self._desks.append(desk)
        try:
            yield
        finally:
            self._desks.remove(desk)

    def _make(self, wanted: Wanted) -> tuple[Arm | Gripper | Hand, HostTimes]:
        sys.path.extend(path for path in wanted.path if path not in sys.path)
        with self._lock:
            driver = self._driver = self._driver or driver_named(wanted.place.driver)
        return getattr(driver, wanted.kind)(self.place.address, wanted.about, wanted.options), driver.host_times

    def _work(self, device: Arm | Gripper | Hand, desk: HostDesk, times: HostTimes) -> None:
        """Measure and execute the program's requests until it closes the device or ends."""
        limits = {HostCall.recover: times.recover, HostCall.guide: times.recover, HostCall.close: times.close}
        while desk.is_used and not self._is_ending:
            rest = times.period if _measure(device, desk, self._limit(times)) else FAILED_REST
            until = time.monotonic() + rest
            while (left := until - time.monotonic()) > 0:
                desk.promise("a pause", left + self._limit(times))
                request = desk.next(left)
                if request is None:
                    break
                call, limit, answer = request.call.name, limits.get(request.call), self._limit(times)
                with contextlib.nullcontext() if limit is None else self._others_wait(call, limit):
                    desk.promise(call, self._limit(times))
                    _answer(device, desk, request, answer)
                if request.call is HostCall.close:
                    return


def _measure(device: Arm | Gripper | Hand, desk: HostDesk, seconds: float) -> bool:
    """Publish a measurement; return True on success."""
    desk.promise("state", seconds)
    try:
        desk.show(device.state())
        return True
    except Exception as err:  # noqa: BLE001  any exception of a driver is a fault of its device
        if not device.fault:
            device.set_fault(in_words(err))
        desk.show_failure(device.fault)
        return False


def _answer(device: Arm | Gripper | Hand, desk: HostDesk, request: HostRequest, seconds: float) -> None:
    """Execute a request and report its outcome."""
    try:
        flag = bool(_do(device, request))
    except InvalidAction as err:
        desk.answer(request, HostOutcome.invalid, str(err))
    except WrongOrder as err:
        desk.answer(request, HostOutcome.wrong_order, str(err))
    except Exception as err:  # noqa: BLE001  any exception of a driver is a fault of its device
        if not device.fault and not isinstance(err, DeviceFault):
            device.set_fault(in_words(err))
        desk.answer(request, HostOutcome.fault, device.fault or str(err))
    else:
        if flag or request.call is HostCall.recover:  # the next measurement must not be older
            _measure(device, desk, seconds)
        desk.answer(request, HostOutcome.done, flag=flag)


def _do(device: Any, request: HostRequest) -> bool | None:
    if request.call is HostCall.has_arrived:
        return device.has_arrived()
    if request.call is HostCall.recover:
        return device.recover()
    if request.call is HostCall.close:
        return device.close()
    if request.is_void:  # the device has been held since
        return None
    if request.call is HostCall.guide:
        return device.guide(True)
    if request.valid_for <= 0:  # too late: end the previous command, as this one would have
        return device.hold()
    if request.period and isinstance(device, StreamedArm) and device.period != request.period:
        device.period = request.period
    command = _COMMANDS[request.call]
    return command(device, request)


_COMMANDS: dict[HostCall, Callable[[Any, HostRequest], None]] = {
    HostCall.joints: lambda device, request: device.command_joints(request.values, request.valid_for),
    HostCall.pose: lambda device, request: device.command_pose(Pose.from_tquat(request.values), request.valid_for),
    HostCall.twist: lambda device, request: device.command_twist(request.values, request.valid_for),
    HostCall.velocities: lambda device, request: device.command_velocities(request.values, request.valid_for),
    HostCall.torques: lambda device, request: device.command_torques(request.values, request.valid_for),
    HostCall.opening: lambda device, request: device.command_opening(
        request.values[0], request.force, request.valid_for
    ),
}


def in_words(err: Exception) -> str:
    """Return the message of a driver's exception, preceded by its class unless RCS defines it."""
    return str(err) if isinstance(err, RcsError) else f"{type(err).__name__}: {err}"


def _end(*_: object) -> NoReturn:
    sys.exit(0)


def main() -> None:
    """Run the host until it ends."""
    words = [word for word in sys.argv[1:] if word != "--stay"]
    place = Place(driver=words[0], address=words[1], library=words[2])
    try:
        starter = os.pidfd_open(int(words[3]))
    except ProcessLookupError:
        return
    if os.getppid() != int(words[3]):  # it ended while this process started, and the number is another's
        return
    faulthandler.enable()
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program, which ends this process
    path = place.socket
    lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit(IN_USE)
    path.unlink(missing_ok=True)  # a host that was killed leaves its socket behind
    listener = socket.socket(socket.AF_UNIX)
    old = os.umask(0o177)
    listener.bind(str(path))
    os.umask(old)
    listener.listen()
    code = 0
    try:
        Host(place, stays="--stay" in sys.argv).run(listener, starter)
    except Exception:  # noqa: BLE001  it is printed
        traceback.print_exc()
        code = 1
    except SystemExit:
        pass
    path.unlink(missing_ok=True)
    os._exit(code)  # a driver's thread that does not end must not keep the process alive


if __name__ == "__main__":
    main()
