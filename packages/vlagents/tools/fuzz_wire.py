"""Sends a server valid messages that were damaged, and what is no message at all, over each wire.

Each wire (shared memory, TCP, websocket, GR00T) has a server in a process of its own, with a random policy, and gets
`--frames` frames, some of them per connection. A frame counts when it was answered, or ended its connection; what came
behind one that did is not counted. Now and then a client of the right kind asks for a chunk, and must get
it. A pickle that would make a file is among the frames.

Prints one JSON object per wire: `frames`, `crashes`, `mb_grown` (resident memory of the server since the first tenth),
`canary` (whether the pickle ever ran), `connections` (all of which were ended), `served` (how often the client got its
chunk).
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import pickle
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from vlagents import Observation, connect
from vlagents.address import parse
from vlagents.other_wires import groot
from vlagents.policies.random import RandomPolicy
from vlagents.wire import openpi
from vlagents.wire.calls import observation_to_values
from vlagents.wire.message import pack
from vlagents.wire.shared import HEAD, MAGIC, PLACE, SEALS, SLOTS, name_beside
from vlagents.wire.stream import PREFIX
from vlagents.wire.zmtp import COMMAND, GREETING

SERVE = """
import logging, sys, threading
from vlagents.other_wires.groot import GrootServer
from vlagents.policies.random import RandomPolicy
from vlagents import Server
from vlagents.websocket import WebsocketServer
logging.disable(logging.CRITICAL)
kind = {"websocket": WebsocketServer, "gr00t": GrootServer}.get(sys.argv[1], Server)
server = kind(RandomPolicy(size=8), port=0).start()
print(server.address, flush=True)
threading.Event().wait()
"""
WIRES = ("shared", "tcp", "websocket", "gr00t")
BURST = 16
"""Frames of a connection."""
ASKED = 50
"""Connections between two calls that must be answered."""
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
READY = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03REQ"
OBSERVATION = Observation(
    images={"side": np.zeros((8, 8, 3), np.uint8)}, state={"joints": np.zeros(7)}, instruction="pick", session="a"
)


ODD: list[Any] = [
    None,
    True,
    -1,
    2**62,
    float("nan"),
    float("inf"),
    "",
    "x" * 300,
    b"\xff",
    [],
    {},
    [[[]]],
    {"a": {"a": {}}},
]
ODD += [
    np.zeros(0),
    np.zeros((2, 2)),
    np.array(3.0),
    np.full(7, np.nan),
    np.zeros((4, 4, 3), np.uint8),
    np.zeros((3, 3, 4), np.uint8),
]
ODD += [np.zeros(9, bool), np.arange(3, dtype=np.uint64), {"jpeg": 3}, {"jpeg": np.zeros(9, np.uint8)}]
"""Values that travel, and belong nowhere."""


class Canary:
    """A pickle that makes a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (Path.touch, (self.path,))


class Frames:
    """Draws frames from a seed."""

    def __init__(self, seed: int, canary: bytes) -> None:
        self.random = Random(seed)
        self._unpleasant = [b"\xff" * 8, b"\x91" * 200, b"\xdf\xff\xff\xff\xff", b"\xc7\xff\x01", canary]
        values = observation_to_values(OBSERVATION)
        self._hello = {"call": "hello", "id": 0, "version": 1}
        self._calls = [
            self._hello,
            {"call": "infer", "id": 1, "observation": values},
            {"call": "reset", "id": 2, "session": "a", "instruction": "b"},
            {"call": "forget", "id": 3, "session": "a"},
            {"call": "ping", "id": 5},
        ]

    def damaged(self, data: bytes) -> bytes:
        """Return bytes with a few of them changed, cut out, doubled, or replaced by something unpleasant."""
        random, found = self.random, bytearray(data)
        for _ in range(random.randrange(4)):
            at, kind = random.randrange(len(found) + 1), random.randrange(6)
            if kind == 0 and found:
                found[min(at, len(found) - 1)] = random.randrange(256)
            elif kind == 1:
                del found[at : at + random.randrange(1, 9)]
            elif kind == 2:
                found[at:at] = found[at : at + random.randrange(1, 40)]
            elif kind == 3:
                found[at:at] = random.randbytes(random.randrange(1, 9))
            elif kind == 4:
                found[at:at] = random.choice(self._unpleasant)
            else:
                found[at : at + 4] = random.randbytes(4)
        return bytes(found)

    def confused(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return a call with one of its values replaced by what does not belong there, but travels."""
        found = {**values}
        at = found
        while True:
            name = self.random.choice([key for key in at if key not in ("call", "id")] or [None])
            if isinstance(at.get(name), dict) and at[name] and self.random.random() < 0.8:
                at[name] = {**at[name]}
                at = at[name]
                continue
            at[name or "more"] = self.random.choice(ODD)
            return found

    def hello(self, wire: str) -> bytes:
        """Return what a connection begins with, undamaged."""
        if wire == "gr00t":
            return GREETING + bytes([COMMAND, len(READY)]) + READY
        return HANDSHAKE if wire == "websocket" else _framed(*pack(self._hello)[:2])

    def frame(self, wire: str) -> tuple[bytes, int | None]:
        """Return a frame, and for shared memory how large the file is that comes with it, if one does."""
        if wire == "shared" and self.random.random() < 0.15:
            return self._shared()
        draw = {"websocket": self._websocket, "gr00t": self._gr00t}.get(wire, self._native)
        return draw(), None

    def _native(self) -> bytes:
        call = self.random.choice(self._calls)
        which = self.random.randrange(12)
        header, parts, _ = pack(self.confused(call) if which > 3 else call)
        if which == 0:  # the lengths are right, what they are of is not
            return _framed(self.damaged(header), parts)
        return self.damaged(_framed(header, parts)) if which == 1 else _framed(header, parts)

    def _shared(self) -> tuple[bytes, int | None]:
        header, _, size = pack(self._calls[1])
        random = self.random
        place = PLACE.pack(random.randrange(3), random.randrange(4), random.choice([1 << 20, 1 << 12, 64, 0, 2**63]))
        frame = PREFIX.pack(MAGIC, len(header), random.choice([size, 0, 1 << 20, 2**62])) + place + header
        made = random.choice([SLOTS << 20, 4096, 0])
        return (self.damaged(frame) if random.random() < 0.5 else frame), (made if random.random() < 0.7 else None)

    def _gr00t(self) -> bytes:
        random = self.random
        seen = {"video": {"side": np.zeros((1, 1, 8, 8, 3), np.uint8)}, "state": {"joints": np.zeros((1, 1, 7), "f4")}}
        seen["language"] = {"task": [["pick"]]}  # type: ignore[assignment]
        request = {"endpoint": random.choice(["get_action", "reset", "ping", "kill"]), "data": {"observation": seen}}
        which = random.randrange(12)
        message = groot.pack(self.confused(request) if which > 3 else request)
        if which == 0:
            message = self.damaged(message)
        frame = (
            b"\x01\x00" + struct.pack(">BQ", random.choice([2, 3, 4, 9]) if which == 1 else 2, len(message)) + message
        )
        return self.damaged(frame) if which == 2 else frame

    def _websocket(self) -> bytes:
        random = self.random
        own: Any = random.choice([{"session": "a", "time": 1.0}, random.choice(self._calls)])
        which = random.randrange(24)
        flat = openpi.observation_to_flat(OBSERVATION)
        if which > 8:
            own = self.confused(own)
        if which > 16:
            flat = self.confused(flat)
        message = openpi.pack({**flat, openpi.OWN: random.choice([5, None]) if which == 2 else own})
        if which == 0:
            message = self.damaged(message)
        first = (
            random.choice([0x81, 0x8A, 0x02, 0x80, 0x88, 0xF2, 0x87]) if which == 3 else 0x89 if which == 4 else 0x82
        )
        message = message[:100] if first & 0x08 else message
        size = len(message)
        head = bytes([first, 0x80 | size]) if size < 126 else struct.pack(">BBH", first, 0xFE, size)
        frame = head + bytes(4) + message  # a mask of zeros changes nothing
        return self.damaged(frame) if which == 1 else frame


def _framed(header: bytes, parts: Any) -> bytes:
    body = b"".join(parts)
    return PREFIX.pack(b"VLA1", len(header), len(body)) + header + body


def sent(wire: str, address: Any, frames: Frames) -> int:
    """Send a burst over a connection of its own; return how many frames were answered or ended it."""
    family = socket.AF_UNIX if wire == "shared" else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as peer:
        peer.settimeout(20.0)
        peer.connect(address)
        came = b""
        try:
            waiting = [frames.hello(wire)]
            for frame, size in (frames.frame(wire) for _ in range(BURST)):
                if size is None:
                    waiting.append(frame)
                    continue
                peer.sendall(b"".join(waiting))
                waiting, file = [], make_memory(size, frames.random)
                try:
                    socket.send_fds(peer, [frame], [file])
                finally:
                    os.close(file)
            peer.sendall(b"".join(waiting))
            peer.shutdown(socket.SHUT_WR)
            while data := peer.recv(1 << 16):
                came += data
        except ConnectionError:
            pass  # it was ended while frames were on their way
    answered = answers(wire, came)
    return min(answered + 1, BURST) if wire != "websocket" else min(max(answered, 1), BURST)


def answers(wire: str, came: bytes) -> int:
    """Return how many frames were answered, the greeting apart."""
    at, count = 0, -1
    if wire == "gr00t":  # an empty frame, and one with 8 bytes of length
        at = len(GREETING) + 2 + len(READY) + 3
        while at + 11 <= len(came):
            at += 11 + int.from_bytes(came[at + 3 : at + 11], "big")
            count += 1
        return max(count, 0)
    if wire == "websocket":
        at = came.find(b"\r\n\r\n") + 4
        while at + 2 <= len(came):
            size = came[at + 1]
            wide = {126: 2, 127: 8}.get(size, 0)
            at += 2 + wide + (int.from_bytes(came[at + 2 : at + 2 + wide], "big") if wide else size)
            count += 1
        return max(count, 0)
    while at + PREFIX.size <= len(came):
        _, header, body = PREFIX.unpack_from(came, at)
        at += PREFIX.size + header + body
        count += 1
    return max(count, 0)


def memory_mb(process: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def make_memory(size: int, random: Random) -> int:
    """Return a file of memory, sealed or not."""
    file = os.memfd_create("fuzz", os.MFD_ALLOW_SEALING)
    os.ftruncate(file, size)
    if size > HEAD:
        os.pwrite(file, random.randrange(3).to_bytes(8, "little"), 0)
    if random.random() < 0.7:
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, SEALS)
    return file


def fuzz(wire: str, frames: int, seed: int) -> dict[str, Any]:
    """Send so many frames over a wire, and return the figures."""
    with tempfile.TemporaryDirectory() as folder:
        canary = Path(folder) / "canary"
        drawn = Frames(seed, pickle.dumps(Canary(canary)))
        serving = subprocess.Popen([sys.executable, "-c", SERVE, wire], stdout=subprocess.PIPE, text=True)
        assert serving.stdout is not None
        try:
            address = parse(serving.stdout.readline().strip())
            place: Any = name_beside(address) if wire == "shared" else (address.host, address.port)
            begin, warm, count, connections, served = time.monotonic(), 0.0, 0, 0, 0
            options: dict[str, Any] = {"is_shared": wire == "shared"} if wire in ("shared", "tcp") else {}
            if wire == "gr00t":
                options["metadata"] = RandomPolicy(size=8).metadata()
            with connect(str(address), timeout=20.0, **options) as good:
                while count < frames:
                    count += sent(wire, place, drawn)
                    connections += 1
                    if connections % ASKED == 0:
                        assert good.infer(OBSERVATION).actions.shape == (1, 8)
                        served += 1
                    if warm == 0.0 and count >= frames // 10:
                        warm = memory_mb(serving.pid)
                assert good.infer(OBSERVATION).actions.shape == (1, 8)
            return {
                "benchmark": "fuzz_wire",
                "wire": wire,
                "frames": count,
                "crashes": int(serving.poll() is not None),
                "mb_grown": round(memory_mb(serving.pid) - warm, 1),
                "canary": canary.exists(),
                "connections": connections,
                "served": served + 1,
                "seconds": round(time.monotonic() - begin, 1),
            }
        finally:
            serving.kill()
            serving.wait()


def main() -> None:
    """Read the options, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000, help="for each wire")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--wire", choices=WIRES, action="append", help="by default each, one after another")
    given = parser.parse_args()
    for wire in given.wire or WIRES:
        print(json.dumps(fuzz(wire, given.frames, given.seed)), flush=True)


if __name__ == "__main__":
    main()
