"""A virtual world whose sensors see a state that stays, and the truth about their clocks."""

from __future__ import annotations

import threading

from rcs.virtual.sensors import DRIFT, device_time
from rcs.virtual.virtual_world import VirtualWorld


class Showing:
    """A virtual world that shows its state 200 times a second on a thread, once it is started."""

    def __init__(self, world: VirtualWorld) -> None:
        self.world = world
        assert world.sensors is not None
        self.sensors = world.sensors
        self._must_end = threading.Event()
        self._thread = threading.Thread(target=self._show, name="world", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _show(self) -> None:
        while not self._must_end.wait(0.005):
            self.sensors.show()

    def tell(self, *words: object) -> None:
        self.world.tell([str(word) for word in words])

    def close(self) -> None:
        self._must_end.set()
        self._thread.join()
        self.world.close()


def truth(name: str, at: float) -> float:
    """Return the host's time of a moment on a virtual sensor's clock."""
    return (at - device_time(name, 0.0)) / (1.0 - DRIFT)
