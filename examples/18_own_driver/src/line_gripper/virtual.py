"""A virtual gripper, which answers the lines of the real one: `python -m line_gripper.virtual`."""

from __future__ import annotations

import socketserver
import threading
import time
from typing import Any

SPEED = 2.5
"""Change of the opening per second [1/s]."""


class VirtualGripper:
    """The gripper's motor and its server. `cut`, `mend` and `trip` are its faults."""

    def __init__(self, port: int = 0) -> None:
        """Listen on a port of this machine, 0 for a free one."""
        gripper = self
        self.is_powered = self.is_cut = False
        self.fault = ""
        self._opening = self._target = 1.0
        self._moved = time.monotonic()
        self._lock = threading.Lock()
        self._clients: set[Any] = set()

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                gripper._clients.add(self.connection)
                try:
                    for line in self.rfile:
                        if gripper.is_cut:
                            return
                        self.wfile.write(f"{gripper.answer(*line.decode().split())}\n".encode())
                except OSError:  # the client is gone
                    return

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = daemon_threads = True

            def verify_request(self, request: Any, client_address: Any) -> bool:
                return not gripper.is_cut

        self._server = Server(("127.0.0.1", port), Handler)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        """Its address for a site."""
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), name="virtual gripper")
        self._thread.start()

    def answer(self, request: str = "", *values: str) -> str:
        """Return the answer to a request."""
        with self._lock:
            self._move()
            if request == "state":
                return f"ok {self._opening:.6f} {self._moved:.6f} {int(self._opening != self._target)}"
            if request == "reset":
                self.fault = ""
                return "ok"
            if request == "off":
                self.is_powered = False
                self._target = self._opening
                return "ok"
            if self.fault:
                return f"error {self.fault}"
            if request == "move":
                self.is_powered = True
                self._target = float(values[0])
                return "ok"
            if request == "stop":
                self._target = self._opening
                return "ok"
            return f"error unknown request {request!r}"

    def cut(self) -> None:
        """Cut the cable; the gripper stops by itself."""
        self.is_cut = True
        with self._lock:
            self._move()
            self._target = self._opening
        for client in self._clients:
            try:
                client.shutdown(2)
            except OSError:  # it has gone already
                continue
        self._clients.clear()

    def mend(self) -> None:
        """Mend the cable."""
        self.is_cut = False

    def trip(self, reason: str) -> None:
        """Enter a fault, in which it refuses everything until `reset`."""
        with self._lock:
            self._move()
            self._target = self._opening
            self.fault = reason

    def close(self) -> None:
        """End."""
        self.cut()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _move(self) -> None:
        now = time.monotonic()
        step = SPEED * (now - self._moved)
        self._opening += min(max(self._target - self._opening, -step), step)
        self._moved = now


if __name__ == "__main__":
    print(VirtualGripper(7007).address, flush=True)
