"""The line between a virtual robot and whoever talks to it: packets pass it late, damaged or never, as it is told.

Threads: every call is safe from any thread. `flush` sends what is due, in order; the loop of the world calls it each
tick. A packet never overtakes another.
"""

from __future__ import annotations

import random
import threading
import time
from collections import deque
from collections.abc import Callable

from rcs.virtual.fault import Fault

Write = Callable[[bytes], object]
"""Sends bytes."""


class Line:
    """What becomes of packets that a robot sends, and of those that come."""

    def __init__(self, seed: int = 0) -> None:
        """Let everything pass.

        Args:
            seed: Of the chances.
        """
        self._random = random.Random(seed)
        self._lock = threading.RLock()
        self._told: dict[str, Fault] = {}
        self._left: dict[str, int] = {}
        self._waiting: deque[tuple[float, bytes, Write]] = deque()
        self.is_cut = False
        """Whether the cable is out: nothing comes and nothing goes."""

    def tell(self, fault: Fault) -> None:
        """Have packets pass `late`, `lose` or `corrupt` them, or `cut` the cable."""
        with self._lock:
            if fault.name == "cut":
                self.is_cut = True
                self._waiting.clear()
                return
            self._left[fault.name] = int(fault.number) if not fault.share else 0
            self._told[fault.name] = fault

    def clear(self) -> None:
        """Let everything pass again."""
        with self._lock:
            self._told.clear()
            self._left.clear()
            self.is_cut = False

    def send(self, packet: bytes, write: Write, after: float = 0.0) -> None:
        """Send a packet now or later, damaged or not at all.

        Args:
            packet: What a receiver takes as one.
            write: Sends it.
            after: How long it takes on a line that is well [s].
        """
        with self._lock:
            now = time.monotonic()
            passed = self.receive(packet)
            if passed is None:
                return
            due = now + after
            late = self._told.get("late")
            if late is not None and (not late.share or self._random.random() * late.share < 1.0):
                due += 1e-3 * late.number
            if not self._waiting and due <= now:
                write(passed)
            else:
                self._waiting.append((due, passed, write))

    def receive(self, packet: bytes) -> bytes | None:
        """Return a packet that comes as it passes the line, None if it is lost."""
        with self._lock:
            if self.is_cut or self._befalls("lose"):
                return None
            return self._damaged(packet) if self._befalls("corrupt") else packet

    def flush(self) -> None:
        """Send what is due."""
        with self._lock:
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                _, packet, write = self._waiting.popleft()
                write(packet)

    @property
    def next_due(self) -> float | None:
        """When the next packet that waits is due, on the monotonic clock [s]; None if none waits."""
        with self._lock:
            return self._waiting[0][0] if self._waiting else None

    def _befalls(self, name: str) -> bool:
        told = self._told.get(name)
        if told is None:
            return False
        if told.share:
            return self._random.random() * told.share < told.number
        left = self._left[name]
        self._left[name] = max(left - 1, 0)
        return left > 0

    def _damaged(self, packet: bytes) -> bytes:
        damaged = bytearray(packet)
        damaged[self._random.randrange(len(damaged))] ^= 1 << self._random.randrange(8)
        return bytes(damaged)
