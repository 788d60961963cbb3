"""Wands and trackers of an HTC Vive, tracked by SteamVR on this machine or on another one."""

from __future__ import annotations

import contextlib
import math
import secrets
import select
import socket
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.spatial import matrix_to_tquat
from rcs.teleop import credentials
from rcs.teleop.device import POLL, Button, Connected, HandReading, Reading
from rcs.teleop.headset_messages import from_headset
from rcs.teleop.quest import address_of
from rcs.teleop.vive_relay import (
    GREETING,
    LEFT,
    POSES,
    RIGHT,
    TRACKER,
    WELCOME,
    Tracked,
    has_ended,
    pack,
    tracked,
    unpack,
)
from rcs.teleop.waking_clock import WakingClock

PERIOD = 0.008
"""Time between two readings of this machine's SteamVR [s]."""
PORT = 7700
MENU, GRIP, PAD = 1, 2, 32
"""Bits of OpenVR's buttons."""
MIDDLE = 0.4
"""Radius of the middle of the touchpad."""
STRAIGHT = 0.01
"""Largest deviation of a matrix from a rotation."""


class SteamVr:
    """SteamVR on this machine."""

    def __init__(self) -> None:
        """Connect; faults as in `InputDevice.open`."""
        self.counts = Counter[str]()
        """Counts of what could not be used, by kind."""
        self._openvr: Any = package_of("vive", "openvr", "A Vive needs")
        try:
            self._openvr.init(self._openvr.VRApplication_Background)
        except self._openvr.OpenVRError as err:
            raise DeviceFault(
                f"SteamVR does not run on this machine ({type(err).__name__}); start it, or give the address at which "
                f"to await vive_relay.py on another one, such as vive:0.0.0.0:{PORT}."
            ) from err
        self._system: Any = self._openvr.VRSystem()
        self._due = 0.0

    def next(self) -> tuple[float, Sequence[Tracked]]:
        """Return devices with the time at which they were there [s]."""
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + PERIOD
        if has_ended(self._system, self._openvr):
            raise DeviceFault("SteamVR has ended; start it again.")
        return time.monotonic(), tracked(self._system, self._openvr)

    def close(self) -> None:
        """Disconnect."""
        self._openvr.shutdown()


class Relay:
    """Packets of SteamVR on another machine."""

    def __init__(self, host: str, port: int, code: str) -> None:
        """Listen at an address of this machine; faults as in `InputDevice.open`."""
        self.counts = Counter[str]()
        """Counts of what could not be used, by kind."""
        self._code = code
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as err:
            self._socket.close()
            raise InvalidSetup(
                f"A relay cannot be awaited at {host}:{port}: {err.strerror}. Give an address of this machine and a "
                "free port, such as vive:0.0.0.0:7701."
            ) from err
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._session, self._number, self._sent = secrets.token_bytes(8), 0, -math.inf
        self._clock = WakingClock()

    def next(self) -> tuple[float, Sequence[Tracked]] | None:
        """Return devices with the time at which they were there [s]; None if there is no news within `POLL`."""
        end = time.monotonic() + POLL
        while (rest := end - time.monotonic()) > 0 and select.select([self._socket], [], [], rest)[0]:
            packet, peer = self._socket.recvfrom(4096)
            arrived = time.monotonic()
            said = unpack(packet, self._code)
            if said is None:
                self.counts["damaged or of another code"] += 1
                continue
            kind, session, number, at, devices = said
            if kind == GREETING:
                self._welcome(session, peer)
            elif session != self._session:  # of one that this program has not begun: have it begin anew
                self.counts["disordered"] += 1
                self._send(pack(GREETING, bytes(8), 0, 0.0, [], self._code), peer)
            elif kind != POSES or number <= self._number or not at > self._sent:
                self.counts["disordered"] += 1
            else:
                self._number, self._sent = number, at
                if (here := self._clock.host_time(at, arrived)) is not None:
                    return here, devices
                self.counts["clock jumped"] += 1  # the other machine was asleep
        return None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _welcome(self, nonce: bytes, peer: Any) -> None:
        """Begin a session anew; packets of all others, such as recorded ones, are none of it."""
        self._session, self._number, self._sent = secrets.token_bytes(8), 0, -math.inf
        self._clock = WakingClock()
        number = int.from_bytes(nonce[:4], "little")
        self._send(pack(WELCOME, self._session, number, 0.0, [], self._code), peer)

    def _send(self, packet: bytes, peer: Any) -> None:
        with contextlib.suppress(OSError):  # it greets again
            self._socket.sendto(packet, peer)


class Vive(Connected[SteamVr | Relay]):
    """Two wands, or one tracker as the right hand; a wand's grip is its clutch."""

    what = "Vive"
    valid_for = 0.08
    hands = ("left", "right")
    has_takeover = False

    def __init__(self, address: str | None = None) -> None:
        """Remember where SteamVR is.

        Args:
            address: `HOST:PORT` of this machine at which to await `vive_relay.py` on another one; None for SteamVR on
                this machine.

        Raises:
            InvalidSetup: The address is none.
        """
        super().__init__()
        self._listens_at = None if address is None else address_of(address, PORT)
        self._presses: dict[int, Button] = {}

    def connect(self) -> SteamVr | Relay:
        """Connect to SteamVR, or await the relay; faults as in `InputDevice.open`."""
        self._presses.clear()
        if self._listens_at is None:
            return SteamVr()
        host, port = self._listens_at
        code = credentials.code()
        relay = Relay(host, port, code)
        own = credentials.own_addresses()[0] if host == "0.0.0.0" else host
        self.instructions = f"On the machine with SteamVR: python vive_relay.py {own}:{relay.port} {code}"
        return relay

    def measure(self, connection: SteamVr | Relay) -> Reading | None:
        """Return what is tracked, 125 times a second at most; None while there is no news."""
        news = connection.next()
        if news is None:
            return None
        at, devices = news
        return Reading(time=at, hands=hands_of(devices, self._presses), counts=dict(connection.counts))

    def close(self) -> None:
        """Disconnect."""
        super().close()
        self.instructions = ""


def hands_of(devices: Sequence[Tracked], presses: dict[int, Button] | None = None) -> dict[str, HandReading]:
    """Return the hands of what is tracked: wands by their role; without any, the only tracker is the right hand.

    Args:
        devices: Whatever is tracked.
        presses: Meanings of touchpads that are held down, by the wand's role, kept up to date; None to keep none.
    """
    presses = {} if presses is None else presses
    gone = HandReading(is_tracked=False, is_there=False)
    found = {one.hand: one for one in devices if one.hand in (LEFT, RIGHT)}
    trackers = [one for one in devices if one.hand == TRACKER]
    if not found and len(trackers) == 1:
        return {"left": gone, "right": _hand_of(trackers[0], presses)}
    sides = {"left": found.get(LEFT), "right": found.get(RIGHT)}
    return {name: gone if one is None else _hand_of(one, presses) for name, one in sides.items()}


def _hand_of(one: Tracked, presses: dict[int, Button]) -> HandReading:
    pose = pose_of(one.matrix) if one.is_tracked else None
    buttons: set[Button] = set()
    if one.buttons >> GRIP & 1:
        buttons.add("clutch")
    if one.buttons >> MENU & 1:
        buttons.add("start")
    if one.buttons >> PAD & 1:  # it means what it began as, wherever the thumb slides
        buttons.add(presses.setdefault(one.hand, _pressed(*one.pad)))
    else:
        presses.pop(one.hand, None)
    is_pulled = one.hand != TRACKER and 0.0 <= one.trigger <= 1.0
    return HandReading(
        pose=pose,
        opening=1.0 - one.trigger if is_pulled else None,
        buttons=frozenset(buttons),
        is_tracked=pose is not None,
    )


def _pressed(right: float, up: float) -> Button:
    """Return the meaning of a press on the touchpad."""
    if not math.hypot(right, up) > MIDDLE:
        return "front"
    if abs(up) > abs(right):
        return "success" if up > 0 else "failure"
    return "reset" if right > 0 else "discard"


def pose_of(matrix: Sequence[float]) -> NDArray[np.float64]:
    """Return the pose of OpenVR's matrix in the axes of an input device, (7,); NaN if it is no pose.

    Args:
        matrix: 3 × 4 by rows [m].
    """
    square = np.vstack([np.reshape(np.asarray(matrix, np.float64), (3, 4)), [0.0, 0.0, 0.0, 1.0]])
    turn = square[:3, :3]
    if not np.isfinite(square).all() or np.abs(turn @ turn.T - np.eye(3)).max() > STRAIGHT or np.linalg.det(turn) < 0:
        return np.full(7, np.nan)
    return from_headset(matrix_to_tquat(square))
