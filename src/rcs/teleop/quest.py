"""A Quest 3 or another headset with a browser: both controllers, over a page that this program serves."""

from __future__ import annotations

import json
import queue
import threading
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import simplejpeg

from rcs.background_thread import BackgroundThread
from rcs.envs.spaces import FRAMES, RGB, Observation
from rcs.errors import InvalidSetup
from rcs.teleop import credentials
from rcs.teleop.device import POLL, Connected, Reading
from rcs.teleop.headset_messages import hand_of
from rcs.teleop.headset_server import HeadsetServer
from rcs.teleop.waking_clock import WakingClock

PORT = 8443
PICTURES = 15.0
"""Most pictures of each camera that a headset gets per second."""
PATIENCE = 2.0
"""Longest time that `close` waits for a picture that is being sent [s]."""
QUALITY = 80
"""Quality of their JPEG."""


class Quest(Connected[HeadsetServer]):
    """Two controllers; each hand's squeeze is its clutch, its trigger closes its gripper."""

    what = "page for headsets"
    valid_for = 0.1
    hands = ("left", "right")

    def __init__(self, address: str | None = None) -> None:
        """Remember where to listen.

        Args:
            address: `HOST:PORT`, such as `192.168.0.2:8443`; None for port 8443 of all addresses of this machine.

        Raises:
            InvalidSetup: The address is neither.
        """
        super().__init__()
        self._host, self._port = address_of(address, PORT)
        self._clock, self._session, self._is_pushed = WakingClock(), 0, False
        self._shown: Feedback | None = None
        self.url = ""
        """Address to open in the headset, with the code; empty while closed."""

    def connect(self) -> HeadsetServer:
        """Serve the page, with a certificate that is made at first use; faults as in `InputDevice.open`."""
        code = credentials.code()
        server = HeadsetServer(self._host, self._port, code, credentials.tls())
        host = credentials.own_addresses()[0] if self._host == "0.0.0.0" else self._host
        self.url = f"https://{host}:{server.port}/#{code}"
        self.instructions = f"Open {self.url} in the headset's browser, and accept its certificate."
        self._shown = Feedback(server)
        return server

    def measure(self, connection: HeadsetServer) -> Reading | None:
        """Return the next frame of the headset; None while there is none."""
        try:
            arrived, frame = connection.frames.get(timeout=POLL)
        except queue.Empty:
            return None
        if connection.sessions != self._session:
            self._clock, self._session = WakingClock(), connection.sessions
        at = self._clock.host_time(1e-3 * frame.time, arrived)
        if at is None:  # the headset was asleep
            connection.counts["clock jumped"] += 1
            return None
        at -= 0.5e-3 * frame.round_trip
        hands = {name: hand_of(name, frame.hands.get(name), was_pushed=self._is_pushed) for name in self.hands}
        self._is_pushed = "takeover" in hands["left"].buttons
        return Reading(time=at, hands=hands, device_time=1e-3 * frame.time, counts=dict(connection.counts))

    def feedback(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Show cameras and the state of the hands in the headset."""
        shown = self._shown  # another thread closes it
        if shown is not None:
            shown.offer(observation, info)

    def close(self) -> None:
        """End the page and its connections."""
        shown, self._shown, self.url, self.instructions = self._shown, None, "", ""
        if shown is not None:
            shown.must_end()
        super().close()
        if shown is not None:
            shown.close()  # once nothing can be sent any more


class Feedback:
    """Sends pictures and states from its own thread; a slow network gets fewer pictures, and delays nobody else."""

    def __init__(self, server: HeadsetServer) -> None:
        """Begin.

        Args:
            server: Sends them.
        """
        self._server = server
        self._shown = Counter[str]()
        self._has_ended = threading.Event()
        self._thread = BackgroundThread[tuple[Observation, Mapping[str, Any]]]("rcs headset pictures", self._send)

    def offer(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Have the newest pictures and states sent."""
        with self._thread.changed:
            self._thread.waiting.clear()
            self._thread.put((observation, info))

    def must_end(self) -> None:
        """Send no more."""
        self._has_ended.set()

    def close(self) -> None:
        """Wait for the thread, which may still be sending."""
        self.must_end()
        self._thread.close(PATIENCE)

    def _send(self, newest: tuple[Observation, Mapping[str, Any]]) -> None:
        if self._has_ended.is_set():
            return
        observation, info = newest
        self._server.send(json.dumps({"states": dict(info.get("operator", {}))}))
        frames = observation.get(FRAMES, {})
        for name in sorted(frames, key=self._shown.__getitem__):  # a picture under way may be all that is let through
            if RGB in frames[name] and self._server.is_keeping_up:
                self._shown[name] += 1
                rgb = np.ascontiguousarray(frames[name][RGB])
                label = name.encode()[:255]
                picture = simplejpeg.encode_jpeg(rgb, quality=QUALITY, colorspace="RGB")
                self._server.send(bytes([len(label)]) + label + picture)
        self._has_ended.wait(1 / PICTURES)


def address_of(given: str | None, port: int) -> tuple[str, int]:
    """Return host and port of an address `HOST:PORT`, `HOST` or `PORT`; None for all addresses of this machine.

    Raises:
        InvalidSetup: It is none of these.
    """
    host, _, last = (given or "").rpartition(":")
    if given and not last.isdigit():
        host, last = (last, "") if not host else ("", "?")
    if last and not (last.isdigit() and int(last) < 1 << 16):
        raise InvalidSetup(f"The address is {given!r}; valid is HOST:PORT, such as 0.0.0.0:{port}, or one of both.")
    return host or "0.0.0.0", int(last) if last else port
