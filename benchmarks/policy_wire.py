"""Measure the round trip to a policy in another process, over our wires and those of others.

The observation has two images of 224 x 224 and two of 1280 x 720 pixels, uint8, and 7 numbers: 5.8 MB. The images are
random, the worst case for whatever compresses. 8 x 8 actions come back. Every server reads one pixel of each image, so
what is measured is the way there and back. All ways take turns, some calls each, and the medians of all calls count.

References: openpi's stock client and its message layout (`openpi-client` wants NumPy below 2, so it runs in
build/interop/openpi, which is made when missing, or with `--openpi PYTHON`), and pyzmq (TCP, several parts, no copies)
where it is installed. `copy_ms` is one copy of the images into memory that is there: on a machine that does other work,
this alone may take longer than the rest of the way.

Prints one JSON object: the medians `shm_ms`, `tcp_ms`, `ws_ms`, those of the references or why there are none, and
`p99_ms` by name.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from vlagents import Chunk, Metadata, Observation, PartSpec, Policy, connect

ROOT = Path(__file__).parents[1]
SIZES = {"left": (224, 224), "right": (224, 224), "front": (720, 1280), "side": (720, 1280)}
Way = Callable[[int], list[float]]
"""A function that makes a number of queries and returns the time of each [s]."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    calls: int = 60
    """Calls of each way in a round."""
    rounds: int = 5
    """Rounds, in which the ways take turns."""
    openpi: Path | None = None
    """An interpreter with openpi-client; by default one is made in build/interop."""
    only: tuple[str, ...] = ()
    """Names of ways, such as shm; by default all."""


class Pixels(Policy):
    """Reads a pixel of each image, and answers with 8 rows of 8 numbers."""

    def metadata(self) -> Metadata:
        """Return the shape of an action."""
        return Metadata(name="pixels", action=(PartSpec("joints", 8),), horizon=8, rate=10.0)

    def infer(self, observation: Observation) -> Chunk:
        """Answer."""
        row = [float(image[0, 0, 0]) for image in map(observation.image, observation.images)]
        return Chunk(np.tile([*row, *row], (8, 1)), 0.1, observation.time)


def serve_ours(kind: str, told: Any) -> None:
    """Serve over our TCP and shared memory, or over our websocket."""
    from vlagents import Server
    from vlagents.websocket import WebsocketServer

    with (WebsocketServer if kind == "ws" else Server)(Pixels(), port=0) as server:
        told.send(str(server.address))
        told.recv()


def serve_zmq(_: str, told: Any) -> None:
    """Serve with ZeroMQ: a part per array."""
    import zmq

    with zmq.Context() as context, context.socket(zmq.REP) as replies:
        told.send(f"tcp://127.0.0.1:{replies.bind_to_random_port('tcp://127.0.0.1')}")
        while True:
            parts = replies.recv_multipart(copy=False)
            row = [float(part.buffer[0]) for part in parts[:4]]
            replies.send(np.tile([*row, *row], (8, 1)), copy=False)


@contextmanager
def served(serve: Callable[[str, Any], None], kind: str) -> Iterator[str]:
    """Serve in a process of its own, and return the address."""
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(kind, there), daemon=True)
    process.start()
    try:
        yield here.recv()
    finally:
        process.kill()
        process.join()


def timed(act: Callable[[], Any], calls: int) -> list[float]:
    """Call a function `calls` times and return the time of each call [s]."""
    times = []
    for _ in range(calls):
        begin = time.perf_counter()
        act()
        times.append(time.perf_counter() - begin)
    return times


def ways(images: dict[str, Any], opened: ExitStack, options: Options) -> dict[str, Way | str]:
    """Return the wanted transports by name, or the reason why one is unavailable."""
    observation = Observation(images=images, state={"joints": np.arange(7.0)}, session="bench")
    memory = np.empty(sum(image.size for image in images.values()), np.uint8)

    def ours(kind: str, **given: Any) -> Way:
        client = opened.enter_context(connect(opened.enter_context(served(serve_ours, kind)), **given))
        assert client.infer(observation).actions.shape == (8, 8)
        return lambda calls: timed(lambda: client.infer(observation), calls)

    makers: dict[str, Callable[[], Way | str]] = {
        "copy": lambda: lambda calls: timed(lambda: copied(images, memory), calls),
        "shm": lambda: ours("vla", is_shared=True),
        "tcp": lambda: ours("vla", is_shared=False),
        "ws": lambda: ours("ws"),
        "zmq": lambda: zmq_way(images, opened),
        "openpi": lambda: openpi_way(opened, options),
    }
    return {name: make() for name, make in makers.items() if not options.only or name in options.only}


def copied(images: dict[str, Any], memory: Any) -> None:
    """Copy images into memory, one behind the other."""
    at = 0
    for image in images.values():
        memory[at : at + image.size] = image.reshape(-1)
        at += image.size


def zmq_way(images: dict[str, Any], opened: ExitStack) -> Way | str:
    """Return the way over ZeroMQ, or why there is none."""
    if importlib.util.find_spec("zmq") is None:
        return "the package pyzmq is not installed"
    import zmq

    address = opened.enter_context(served(serve_zmq, ""))
    asks = opened.enter_context(opened.enter_context(zmq.Context()).socket(zmq.REQ))
    asks.setsockopt(zmq.LINGER, 0)
    asks.connect(address)

    def ask() -> None:
        asks.send_multipart([*images.values(), np.arange(7.0)], copy=False)
        assert np.frombuffer(asks.recv(), np.float64).size == 64

    return lambda calls: timed(ask, calls)


def openpi_way(opened: ExitStack, options: Options) -> Way | str:
    """Return the way of openpi's stock client to a server with its layout, or why there is none."""
    place = ROOT / "build" / "interop" / "openpi"
    if options.openpi is None and not (place / ".stamp").exists():
        made = subprocess.run([ROOT / "tools" / "reader_environment", sys.executable, "openpi"], check=False)
        if made.returncode:
            return "its environment could not be made; --openpi names an interpreter that has openpi-client"
    python = options.openpi or place / "bin" / "python"
    folder = ROOT / "tests" / "interop"
    serving = subprocess.Popen([python, folder / "openpi_server.py"], stdout=subprocess.PIPE, text=True)
    opened.callback(serving.kill)
    assert serving.stdout is not None
    address = serving.stdout.readline().strip()

    def ask(calls: int) -> list[float]:
        command = [python, folder / "ask_openpi.py", address, str(calls)]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        return json.loads(said)["times"]

    return ask


def main(options: Options) -> None:
    """Measure and print."""
    random = np.random.default_rng(0)
    images = {name: random.integers(0, 256, (*size, 3), np.uint8) for name, size in SIZES.items()}
    times: dict[str, list[float]] = {}
    result: dict[str, Any] = {"benchmark": "policy_wire", "mb": round(sum(i.nbytes for i in images.values()) / 1e6, 2)}
    with ExitStack() as opened:
        found = ways(images, opened, options)
        for turn in range(options.rounds + 1):
            for name, way in found.items():
                if not isinstance(way, str):
                    took = way(options.calls if turn else 5)
                    times.setdefault(name, []).extend(took if turn else [])  # the first round warms up
        result |= {f"{name}_skipped": why for name, why in found.items() if isinstance(why, str)}
    result |= {f"{name}_ms": round(1e3 * float(np.median(each)), 3) for name, each in times.items()}
    result["p99_ms"] = {name: round(1e3 * float(np.quantile(each, 0.99)), 3) for name, each in times.items()}
    result |= {"load": round(os.getloadavg()[0], 1), "cores": len(os.sched_getaffinity(0))}
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Options))
