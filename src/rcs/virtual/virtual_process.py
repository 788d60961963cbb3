"""A context manager for a virtual robot in a separate process."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

from rcs.errors import InvalidSetup, SimulationError
from rcs.hardware.site import Site
from rcs.virtual.control import tell

END = 10.0
"""Timeout for its end, after which it is killed [s]."""


class VirtualProcess:
    """Starts `rcs virtual`, waits until it is ready, and ends it.

    Examples:
        >>> from rcs.virtual import VirtualProcess
        >>> with VirtualProcess("so101") as virtual:
        ...     with rcs.make("PickCuboid", robot="so101", hardware=virtual.site) as env:
        ...         env.reset()
        ...         virtual.tell("cut")
    """

    def __init__(
        self,
        robot: str,
        *,
        address: str | None = None,
        setup: Path | str | None = None,
        seed: int = 0,
        log: Path | str | None = None,
        cameras: Sequence[str] = (),
        depth: bool = False,
        tactile: bool = False,
    ) -> None:
        """Store the command; arguments as in `rcs virtual`."""
        given = {"--address": address, "--setup": setup, "--seed": seed, "--log": log}
        options = [word for name, value in given.items() if value is not None for word in (name, str(value))]
        options += ["--cameras", *cameras] if cameras else []
        options += ["--depth"] * depth + ["--tactile"] * tactile
        self._command = [sys.executable, "-m", "rcs", "virtual", robot, *options]
        self._process: subprocess.Popen[str] | None = None
        self._words: IO[str] | None = None
        self.name = ""
        """Name for sending faults to it."""
        self.site = Site()
        """Site of its devices, for `rcs.make(hardware=...)`."""

    def __enter__(self) -> VirtualProcess:
        """Start the process and wait until it is ready.

        Raises:
            InvalidSetup: It does not start; the message quotes its output.
        """
        self._words = tempfile.TemporaryFile("w+")
        self._process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stderr=self._words, stdin=subprocess.DEVNULL, text=True
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            raise InvalidSetup(f"`rcs {' '.join(self._command[3:])}` does not start: {self._last_words()}")
        report = json.loads(line)
        self.name, self.site = report["name"], Site(**report["site"])
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        self.close()

    @property
    def pid(self) -> int:
        """Process ID."""
        assert self._process is not None, "it has not been started"
        return self._process.pid

    def tell(self, *words: object) -> str:
        """Send a fault, such as `tell("lose", 3)`, or `tell("left/lose", 3)` to one of several robots, or to a camera.

        Returns:
            The answer to a question such as `judge`; empty for a fault.
        """
        robot, slash, fault = str(words[0]).rpartition("/")
        return tell(f"{self.name}{slash}{robot}", [fault, *map(str, words[1:])])

    def close(self) -> None:
        """End the process and wait for it; closing twice is harmless.

        Raises:
            SimulationError: It failed earlier; the message quotes its output.
        """
        if self._process is None:
            return
        process, self._process = self._process, None
        has_failed = bool(process.poll())
        process.terminate()
        try:
            process.communicate(timeout=END)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        words = self._last_words()
        if has_failed:
            raise SimulationError(f"The virtual robot {self.name!r} has failed: {words}")

    def _last_words(self) -> str:
        assert self._words is not None, "it was started"
        with self._words as words:
            words.seek(0)
            return words.read().strip()
