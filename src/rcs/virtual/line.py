"""The line between a virtual robot and its clients, which delays, damages or loses packets on demand.

Threads: all calls are thread-safe. `flush` sends due packets in order; the loop of the world calls it each tick. A
packet never overtakes another.
"""

from __future__ import annotations

import random
import threading
import time
from collections import deque
from collections.abc import Callable

from rcs.virtual.fault import Fault

Write = Callable[[bytes], object]
"""A function that sends bytes."""


class Line:
    """Applies faults to the packets that a robot sends and receives."""

    def __init__(self, seed: int = 0) -> None:
        """Start without faults.

        Args:
            seed: Random seed of the faults.
        """
        self._random = random.Random(seed)
        self._lock = threading.RLock()
        self._faults: dict[str, Fault] = {}
        self._left: dict[str, int] = {}
        self._waiting: deque[tuple[float, bytes, Write]] = deque()
        self.is_cut = False
        """True while the cable is cut: no packet passes."""

    def tell(self, fault: Fault) -> None:
        """Apply a fault: delay (`late`), `lose` or `corrupt` packets, or `cut` the cable."""
        with self._lock:
            if fault.name == "cut":
                self.is_cut = True
                self._waiting.clear()
                return
            self._left[fault.name] = int(fault.number) if not fault.share else 0
            self._faults[fault.name] = fault

    def clear(self) -> None:
        """End all faults."""
        with self._lock:
            self._faults.clear()
            self._left.clear()
            self.is_cut = False

    def send(self, packet: bytes, write: Write, after: float = 0.0) -> None:
        """Send a packet now or later, damaged or not at all.

        Args:
            packet: A packet as the receiver sees it.
            write: Sends the packet.
            after: Delay of a line without faults [s].
        """
        with self._lock:
            now = time.monotonic()
            passed = self.receive(packet)
            if passed is None:
                return
            due = now + after
            late = self._faults.get("late")
            if late is not None and (not late.share or self._random.random() * late.share < 1.0):
                due += 1e-3 * late.number
            if not self._waiting and due <= now:
                write(passed)
            else:
                self._waiting.append((due, passed, write))

    def receive(self, packet: bytes) -> bytes | None:
        """Return a received packet after it has passed the line; None if it is lost."""
        with self._lock:
            if self.is_cut or self._befalls("lose"):
                return None
            return self._damaged(packet) if self._befalls("corrupt") else packet

    def flush(self) -> None:
        """Send due packets."""
        with self._lock:
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                _, packet, write = self._waiting.popleft()
                write(packet)

    @property
    def next_due(self) -> float | None:
        """Time at which the next waiting packet is due, on the monotonic clock [s]; None if none waits."""
        with self._lock:
            return self._waiting[0][0] if self._waiting else None

    def _befalls(self, name: str) -> bool:
        fault = self._faults.get(name)
        if fault is None:
            return False
        if fault.share:
            return self._random.random() * fault.share < fault.number
        left = self._left[name]
        self._left[name] = max(left - 1, 0)
        return left > 0

    def _damaged(self, packet: bytes) -> bytes:
        damaged = bytearray(packet)
        damaged[self._random.randrange(len(damaged))] ^= 1 << self._random.randrange(8)
        return bytes(damaged)
