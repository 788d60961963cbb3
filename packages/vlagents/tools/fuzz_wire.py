"""Sends a server valid messages that were damaged, and what is no message at all, over each wire.

A server in a process of its own serves a random policy, whose shared memory, TCP port and websocket get `--frames`
frames each. Every hundredth frame, a client of the right kind asks for a chunk and must get it. A pickle that would
make a file is among the frames.

Prints one JSON object: `frames` per wire, `crashes`, `mb_grown` (resident memory of the server since the first tenth),
`canary` (whether the pickle ever ran), `refused` and `answered` frames by wire.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import pickle
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from vlagents import Observation
from vlagents.client import Client
from vlagents.websocket import WebsocketClient
from vlagents.wire import openpi
from vlagents.wire.calls import observation_to_values
from vlagents.wire.message import pack
from vlagents.wire.shared import HEAD, MAGIC, PLACE, SEALS, SLOTS
from vlagents.wire.stream import PREFIX

SERVE = """
import sys, threading
from vlagents.policies.random import RandomPolicy
from vlagents.server import Server
from vlagents.websocket import WebsocketServer
import logging
logging.disable(logging.CRITICAL)
one, other = Server(RandomPolicy(size=8), port=0).start(), WebsocketServer(RandomPolicy(size=8), port=0).start()
print(one.address, one._unix, other.address, flush=True)
threading.Event().wait()
"""
OBSERVATION = Observation(
    images={"side": np.zeros((8, 8, 3), np.uint8)}, state={"joints": np.zeros(7)}, instruction="pick", session="a"
)


class Canary:
    """A pickle that makes a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (Path.touch, (self.path,))


class Frames:
    """Draws frames from a seed."""

    def __init__(self, seed: int, canary: bytes) -> None:
        self._random = np.random.default_rng(seed)
        self._canary = canary
        values = observation_to_values(OBSERVATION)
        self._calls = [
            {"call": "hello", "id": 0, "version": 1},
            {"call": "infer", "id": 1, "observation": values},
            {"call": "reset", "id": 2, "session": "a", "instruction": "b"},
            {"call": "forget", "id": 3, "session": "a"},
            {"call": "metadata", "id": 4},
            {"call": "ping", "id": 5},
        ]

    def damaged(self, data: bytes) -> bytes:
        """Return bytes with a few of them changed, cut out, doubled, or replaced by something unpleasant."""
        random = self._random
        found = bytearray(data)
        for _ in range(int(random.integers(0, 4))):
            at = int(random.integers(0, len(found) + 1))
            kind = random.integers(0, 6)
            if kind == 0 and found:
                found[min(at, len(found) - 1)] = int(random.integers(0, 256))
            elif kind == 1:
                del found[at : at + int(random.integers(1, 9))]
            elif kind == 2:
                found[at:at] = found[at : at + int(random.integers(1, 40))]
            elif kind == 3:
                found[at:at] = bytes(random.integers(0, 256, int(random.integers(1, 9)), np.uint8))
            elif kind == 4:
                found[at:at] = [b"\xff" * 8, b"\x91" * 200, b"\xdf\xff\xff\xff\xff", b"\xc7\xff\x01", self._canary][
                    int(random.integers(0, 5))
                ]
            else:
                found[at : at + 4] = int(random.integers(0, 2**32)).to_bytes(4, "little")
        return bytes(found)

    def native(self) -> bytes:
        """Return a frame for TCP."""
        header, parts, size = pack(self._calls[int(self._random.integers(0, len(self._calls)))])
        body = b"".join(parts)
        which = self._random.integers(0, 3)
        if which == 0:  # the lengths are right, what they are of is not
            header = self.damaged(header)
            return PREFIX.pack(b"VLA1", len(header), size) + header + body
        frame = PREFIX.pack(b"VLA1", len(header), size) + header + body
        return self.damaged(frame) if which == 1 else frame

    def shared(self) -> tuple[bytes, int | None]:
        """Return a frame for a Unix socket, and how large its memory is said and made to be."""
        header, _, size = pack(self._calls[1])
        random = self._random
        slot_size = int(random.choice([1 << 20, 1 << 12, 64, 0, 2**63]))
        size = int(random.choice([size, 0, 1 << 20, 2**62]))
        place = PLACE.pack(int(random.integers(0, 3)), int(random.integers(0, 4)), slot_size)
        frame = PREFIX.pack(MAGIC, len(header), size) + place + header
        made = int(random.choice([SLOTS << 20, 4096, 0]))
        return (self.damaged(frame) if random.random() < 0.5 else frame), (made if random.random() < 0.7 else None)

    def openpi(self) -> bytes:
        """Return a message for a websocket."""
        flat: dict[str, Any] = openpi.observation_to_flat(OBSERVATION)
        own = [{"session": "a", "time": 1.0}, self._calls[int(self._random.integers(0, 6))], 5, None]
        values = {**flat, openpi.OWN: own[int(self._random.integers(0, 4))]}
        return self.damaged(openpi.pack(values))


class Peer:
    """A raw connection that is made anew whenever the server ends it."""

    def __init__(self, address: Any, family: socket.AddressFamily, hello: bytes) -> None:
        self._address, self._family, self._hello = address, family, hello
        self._socket: socket.socket | None = None
        self.refused = 0

    def send(self, frame: bytes, file: int | None = None) -> None:
        """Send a frame, with a file if there is one, and read whatever came back."""
        if self._socket is None:
            self._socket = socket.socket(self._family, socket.SOCK_STREAM)
            self._socket.settimeout(5.0)
            self._socket.connect(self._address)
            self._socket.sendall(self._hello)
        try:
            if file is None:
                self._socket.sendall(frame)
            else:
                socket.send_fds(self._socket, [frame], [file])
            self._socket.setblocking(False)
            while data := self._socket.recv(1 << 16):
                pass
            if data == b"":
                raise ConnectionError
        except BlockingIOError:
            self._socket.settimeout(5.0)
        except OSError:
            self._socket.close()
            self._socket = None
            self.refused += 1

    def end(self) -> None:
        """End a connection that a half message may have stopped."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def memory_mb(process: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def make_memory(size: int, random: np.random.Generator) -> int:
    """Return a file of memory, sealed or not."""
    file = os.memfd_create("fuzz", os.MFD_ALLOW_SEALING)
    os.ftruncate(file, size)
    if size > HEAD:
        os.pwrite(file, int(random.integers(0, 3)).to_bytes(8, "little"), 0)
    if random.random() < 0.7:
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, SEALS)
    return file


def fuzz(frames: int, seed: int) -> dict[str, Any]:
    """Send so many frames over each wire, and return the figures."""
    with tempfile.TemporaryDirectory() as folder:
        canary = Path(folder) / "canary"
        drawn = Frames(seed, pickle.dumps(Canary(canary)))
        serving = subprocess.Popen([sys.executable, "-c", SERVE], stdout=subprocess.PIPE, text=True)
        assert serving.stdout is not None
        try:
            tcp, unix, websocket = serving.stdout.readline().split()
            host, port = tcp.removeprefix("vla://").rsplit(":", 1)
            header, _, _ = pack({"call": "hello", "id": 0, "version": 1})
            hello = PREFIX.pack(b"VLA1", len(header), 0) + header
            peers = {
                "tcp": Peer((host, int(port)), socket.AF_INET, hello),
                "shared": Peer(unix, socket.AF_UNIX, hello),
            }
            return _send(drawn, frames, serving, canary, peers, tcp, websocket)
        finally:
            serving.kill()
            serving.wait()


def _send(
    drawn: Frames, frames: int, serving: Any, canary: Path, peers: dict[str, Peer], tcp: str, websocket: str
) -> dict[str, Any]:
    random = np.random.default_rng(1)
    good = {"shared": Client(tcp, is_shared=True), "tcp": Client(tcp, is_shared=False)}
    good_websocket = WebsocketClient(websocket)
    evil: WebsocketClient | None = None
    refused, warm, answered = 0, 0.0, 0
    for number in range(frames):
        peers["tcp"].send(drawn.native())
        frame, size = drawn.shared()
        file = None if size is None else make_memory(size, random)
        peers["shared"].send(frame, file)
        if file is not None:
            os.close(file)
        if evil is None or evil._connection is None:
            evil = WebsocketClient(websocket)
        assert evil._connection is not None
        try:
            evil._connection.send(drawn.openpi())
            if isinstance(evil._connection.recv(timeout=10.0), str):
                raise ConnectionError
        except Exception:  # noqa: BLE001  whatever the library raises for a connection that was ended
            refused += 1
            evil.close()
            evil = None
        if number % 20 == 19:
            for peer in peers.values():
                peer.end()
        if number % 100 == 99:
            for client in (*good.values(), good_websocket):
                assert client.infer(OBSERVATION).actions.shape == (1, 8)
                answered += 1
        if number == frames // 10:
            warm = memory_mb(serving.pid)
    grown = memory_mb(serving.pid) - warm
    for client in (*good.values(), good_websocket):
        client.close()
    if evil is not None:
        evil.close()
    time.sleep(0.1)
    return {
        "benchmark": "fuzz_wire",
        "frames": frames,
        "crashes": int(serving.poll() is not None),
        "mb_grown": round(grown, 1),
        "canary": canary.exists(),
        "refused": {**{name: peer.refused for name, peer in peers.items()}, "websocket": refused},
        "answered": answered,
    }


def main() -> None:
    """Read the options, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000, help="for each wire")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(json.dumps(fuzz(given.frames, given.seed)))


if __name__ == "__main__":
    main()
