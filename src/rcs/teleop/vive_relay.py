"""Sends what SteamVR tracks to the machine that drives the robot; a program by itself.

It needs Python and openvr (`pip install openvr`), and nothing of this library: copy the file to the machine with
SteamVR and run `python vive_relay.py HOST:PORT CODE`, with the address and the code that
`rcs teleop --input vive:HOST:PORT` shows.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import socket
import struct
import sys
import time
from typing import Any, NamedTuple

RATE = 120.0
"""Packets per second; lighthouses and wands measure at 250 Hz and more."""
MAGIC = b"RCV1"
GREETING, WELCOME, POSES = 0, 1, 2
"""Kinds of packets."""
HEAD = struct.Struct("<4sB8sIdB")
"""Magic, kind, session, number, time of the sender [s], number of devices."""
DEVICE = struct.Struct("<BB12fQ3f")
"""Hand, whether it is tracked, rows of its matrix, buttons, trigger, touchpad."""
SEAL = 16
"""Bytes of the code's signature at the end of a packet."""
LEFT, RIGHT, TRACKER = 1, 2, 3
"""Hands: as OpenVR numbers the roles of controllers; trackers have none."""
MOST = 16
"""Most devices in a packet."""
PATIENCE = 1.0
"""Time between two greetings [s]."""


class Tracked(NamedTuple):
    """A controller or a tracker."""

    hand: int
    """`LEFT`, `RIGHT` or `TRACKER`."""
    is_tracked: bool
    """Whether the pose is valid."""
    matrix: tuple[float, ...]
    """Pose in the room, 3 × 4 by rows: x to the right, y up, z to the back [m]."""
    buttons: int
    """Bits of the buttons that are held."""
    trigger: float
    """How far the trigger is pulled, 0 … 1."""
    pad: tuple[float, float]
    """Where the touchpad is touched: to the right and up, -1 … 1."""


def tracked(system: Any, openvr: Any) -> list[Tracked]:
    """Return all controllers and trackers that are connected.

    Args:
        system: OpenVR's system.
        openvr: The package.
    """
    poses = system.getDeviceToAbsoluteTrackingPose(openvr.TrackingUniverseStanding, 0.0, None)
    found = []
    for at, pose in enumerate(poses):
        kind = system.getTrackedDeviceClass(at) if pose.bDeviceIsConnected else openvr.TrackedDeviceClass_Invalid
        if kind not in (openvr.TrackedDeviceClass_Controller, openvr.TrackedDeviceClass_GenericTracker):
            continue
        is_tracked = bool(pose.bPoseIsValid) and pose.eTrackingResult == openvr.TrackingResult_Running_OK
        matrix = tuple(float(pose.mDeviceToAbsoluteTracking.m[row][column]) for row in range(3) for column in range(4))
        hand, buttons, trigger, pad = TRACKER, 0, 0.0, (0.0, 0.0)
        if kind == openvr.TrackedDeviceClass_Controller:
            hand = system.getControllerRoleForTrackedDeviceIndex(at)
            _, state = system.getControllerState(at)
            buttons, trigger = int(state.ulButtonPressed), float(state.rAxis[1].x)
            pad = float(state.rAxis[0].x), float(state.rAxis[0].y)
        if hand in (LEFT, RIGHT, TRACKER):
            found.append(Tracked(hand, is_tracked, matrix, buttons, trigger, pad))
    return found[:MOST]


def has_ended(system: Any, openvr: Any) -> bool:
    """Return whether SteamVR has said that it ends, since the last call."""
    event, is_over = openvr.VREvent_t(), False
    while system.pollNextEvent(event):
        is_over |= event.eventType == openvr.VREvent_Quit
    return is_over


def pack(kind: int, session: bytes, number: int, at: float, devices: list[Tracked], code: str) -> bytes:
    """Return a packet, signed with the code."""
    body = HEAD.pack(MAGIC, kind, session, number, at, len(devices))
    for one in devices:
        body += DEVICE.pack(one.hand, one.is_tracked, *one.matrix, one.buttons, one.trigger, *one.pad)
    return body + seal(body, code)


def unpack(packet: bytes, code: str) -> tuple[int, bytes, int, float, list[Tracked]] | None:
    """Return kind, session, number, time and devices of a packet; None if it is none, or signed with another code."""
    body, signature = packet[:-SEAL], packet[-SEAL:]
    if len(body) < HEAD.size or not hmac.compare_digest(signature, seal(body, code)):
        return None
    magic, kind, session, number, at, count = HEAD.unpack_from(body)
    if magic != MAGIC or count > MOST or len(body) != HEAD.size + count * DEVICE.size:
        return None
    devices = []
    for hand, is_tracked, *values in DEVICE.iter_unpack(body[HEAD.size :]):
        matrix, (buttons, trigger, right, up) = tuple(values[:12]), values[12:]
        devices.append(Tracked(hand, bool(is_tracked), matrix, buttons, trigger, (right, up)))
    return kind, session, number, at, devices


def seal(body: bytes, code: str) -> bytes:
    """Return the signature of a packet."""
    return hmac.new(code.encode(), body, hashlib.sha256).digest()[:SEAL]


def meet(link: socket.socket, code: str) -> bytes:
    """Return the session that the other side has begun, once it answers; an old recording of packets is of another."""
    has_said = False
    while True:
        nonce, end = os.urandom(8), time.monotonic() + PATIENCE
        with contextlib.suppress(OSError):  # nobody listens yet, or answers in time
            link.send(pack(GREETING, nonce, 0, time.perf_counter(), [], code))
            while (rest := end - time.monotonic()) > 0:
                link.settimeout(rest)
                said = unpack(link.recv(2048), code)
                # An answer to this greeting has its number; those to earlier ones may come first.
                if said is not None and said[0] == WELCOME and said[2] == int.from_bytes(nonce[:4], "little"):
                    link.setblocking(False)
                    return said[1]
        if not has_said:
            print("Waiting for the robot's machine; check address and code if this takes long.", flush=True)  # noqa: T201
            has_said = True
        time.sleep(0.1)


def main(address: str, code: str) -> None:
    """Send until SteamVR ends.

    Args:
        address: `HOST:PORT` of the robot's machine.
        code: The code that it shows.
    """
    import openvr  # pyright: ignore[reportMissingImports]  an extra

    host, _, port = address.rpartition(":")
    openvr.init(openvr.VRApplication_Background)
    system = openvr.VRSystem()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect((host, int(port)))
        session, number = meet(link, code), 0
        print(f"Connected to {address}. Ctrl-C ends.", flush=True)  # noqa: T201
        while not has_ended(system, openvr):
            number += 1
            try:
                link.send(pack(POSES, session, number, time.perf_counter(), tracked(system, openvr), code))
                while True:  # whoever begins anew greets
                    said = unpack(link.recv(2048), code)
                    if said is not None and said[0] == GREETING:
                        session, number = meet(link, code), 0
            except BlockingIOError:
                time.sleep(1.0 / RATE)
            except OSError:  # nobody listens any more, or the network is down
                session, number = meet(link, code), 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("use: python vive_relay.py HOST:PORT CODE")
    with contextlib.suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
