"""The cameras and tactile sensors of a virtual world, drawn and served by a process of their own.

The loop of the world copies its state, and the forces on the gels, into shared memory in every tick, which takes
microseconds; the process draws it when a sensor's next picture is due, so that drawing never delays a tick.
"""

from __future__ import annotations

import json
import os
import select
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from mmap import mmap
from typing import Any

import numpy as np

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, SimulationError
from rcs.sim.tactile import read_force
from rcs.sim.tactile_mounts import TactilePlacement
from rcs.sim.world import World
from rcs.virtual.fault import Fault

LATENCY = 0.06
"""Time from a picture's moment to its sending [s], typical of webcams; it contains drawing."""
DRIFT = 5e-5
"""How much slower the clocks of virtual sensors are than the host's, typical of quartzes."""
FAULTS: Mapping[str, str] = {
    "freeze": "S",
    "delay": "MS",
    "drop": "P",
    "black": "",
    "tear": "",
    "unplug": "S",
    "swap": "OTHER",
    "clear": "",
}
"""Faults of a sensor: no picture for S seconds; pictures MS milliseconds late; a share P of pictures lost; black
pictures; pictures with their end missing; unplugged for S seconds; another sensor's pictures and serial number."""
START, END = 60.0, 5.0
"""Timeouts for the process's start, in which a busy machine composes its world, and for its answers and its end [s]."""
WRITING = 0.5
"""Longest time in which a state is written [s]."""
_HEAD = struct.Struct("qd")


class SharedState:
    """The newest state of a world, then the forces on its gels, in shared memory, with the moment of writing."""

    def __init__(self, size: int, file: int | None = None) -> None:
        """Make the memory, or map that of another process.

        Args:
            size: Number of values: of the state, and one for each gel.
            file: File descriptor of the memory; None to make it.
        """
        length = _HEAD.size + 8 * size
        self.file = os.memfd_create("rcs virtual world", 0) if file is None else file
        if file is None:
            os.ftruncate(self.file, length)
        self._memory = mmap(self.file, length)
        self._values = np.frombuffer(self._memory, np.float64, size, _HEAD.size)
        self._last: tuple[np.ndarray[Any, np.dtype[np.float64]], float] = (np.zeros(size), 0.0)
        self._count = 0

    def write(self, values: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        """Write the values of this moment, forces in newtons."""
        self._count += 1
        _HEAD.pack_into(self._memory, 0, 2 * self._count - 1, 0.0)
        self._values[:] = values
        _HEAD.pack_into(self._memory, 0, 2 * self._count, time.monotonic())

    def read(self) -> tuple[np.ndarray[Any, np.dtype[np.float64]], float]:
        """Return the newest values and their moment [s, monotonic]; the moment is 0 before the first.

        If the writer ended in the middle of writing, they are those of the read before.
        """
        limit = time.monotonic() + WRITING
        while True:
            before, moment = _HEAD.unpack_from(self._memory, 0)
            values = self._values.copy()
            if before % 2 == 0 and _HEAD.unpack_from(self._memory, 0)[0] == before:
                self._last = (values, moment)
            elif time.monotonic() < limit:
                time.sleep(2e-5)
                continue
            return self._last


class VirtualSensors:
    """The world's end of the process."""

    def __init__(self, world: World, setup: Setup, skins: Sequence[TactilePlacement]) -> None:
        """Start the process and wait until it serves.

        Args:
            world: The world whose states are drawn.
            setup: Its setup, with the cameras and the tactile sensors.
            skins: The placements of these tactile sensors.

        Raises:
            InvalidSetup: The process does not start; the message has its words.
        """
        self._world = world
        self._forces = [read_force(world, skin) for skin in skins]
        size = world.core.state_size + len(skins)
        self._shared = SharedState(size)
        self.show()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rcs.virtual.sensor_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[self._shared.file],
            text=True,
        )
        about = {"setup": setup.to_json(), "file": self._shared.file, "size": size}
        told = self._ask(about, START)
        if "port" not in told:
            self.close()
            raise InvalidSetup(
                f"The cameras of the virtual world do not start: {told.get('error', 'no answer, or see above')}"
            )
        self._port: int = told["port"]
        self._cameras: Mapping[str, str] = told["cameras"]
        self._skins: Mapping[str, str] = told["tactile"]

    @property
    def names(self) -> list[str]:
        """Names of cameras and tactile sensors."""
        return [*self._cameras, *self._skins]

    def named(self, name: str) -> str:
        """Return the sensor with a name, or the only one whose name has it after `_`; empty for none."""
        ends = [one for one in self.names if one.endswith(f"_{name}")]
        return name if name in self.names else ends[0] if len(ends) == 1 else ""

    def site(self) -> dict[str, dict[str, Any]]:
        """Return the entries of a site."""

        def entry(name: str, driver: str) -> dict[str, Any]:
            options = {"latency": LATENCY, "serial": serial_of(name)}
            return {"driver": driver, "address": f"http://127.0.0.1:{self._port}/{name}", "options": options}

        cameras = {name: entry(name, driver) for name, driver in self._cameras.items()}
        skins = {name: entry(name, driver) for name, driver in self._skins.items()}
        return {kind: found for kind, found in (("cameras", cameras), ("tactile", skins)) if found}

    def show(self) -> None:
        """Have the sensors see the present state of the world."""
        # The forces are those of the step that led to the state, and do not follow from it.
        self._shared.write(np.append(self._world.core.get_state(), self._world.forces[self._forces]))

    def tell(self, name: str, words: Sequence[str]) -> None:
        """Cause a fault of a sensor.

        Raises:
            UnknownName: There is no such fault; the message lists the valid ones.
            InvalidSetup: Its value is not valid.
            SimulationError: The process has ended.
        """
        fault = Fault.parse(words, FAULTS)
        value: float | str = ""
        if fault.name == "swap":
            value = self.named(fault.value)
            if not value:
                raise InvalidSetup(f"There is no sensor {fault.value!r} to swap with; valid: {', '.join(self.names)}.")
        elif fault.value:
            value = fault.number
            if fault.name == "drop" and value > 1:
                raise InvalidSetup(f"The value of drop is {fault.value!r}; valid is a share of pictures, 0 to 1.")
        if "done" not in self._ask({"sensor": name, "fault": fault.name, "value": value}):
            raise SimulationError("The process that draws the cameras has ended.")

    def close(self) -> None:
        """End the process; closing twice is harmless."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            with suppress(OSError):  # words that were left when it was killed
                self._process.stdin.close()
            try:
                self._process.wait(END)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            assert self._process.stdout is not None
            self._process.stdout.close()
            os.close(self._shared.file)

    def _ask(self, words: Mapping[str, Any], limit: float = END) -> dict[str, Any]:
        """Return the answer of the process; empty if it has ended, or is killed because it gives none in time [s]."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(words) + "\n")
            self._process.stdin.flush()
            if not select.select([self._process.stdout], [], [], limit)[0]:
                self._process.kill()
            line = self._process.stdout.readline()
        except (OSError, ValueError):  # it has ended
            return {}
        return json.loads(line) if line else {}


def serial_of(name: str) -> str:
    """Return the serial number of a virtual sensor."""
    return f"virtual-{name}"


def device_time(name: str, moment: float) -> float:
    """Return a moment [s, monotonic clock of the host] on the clock of a virtual sensor [s]."""
    return moment * (1.0 - DRIFT) + zlib.crc32(name.encode()) % 10_000
