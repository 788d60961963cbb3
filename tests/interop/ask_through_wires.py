"""Lets openpi's stock client ask our websocket server, and ours ask a server with openpi's layout.

Run with our interpreter: `python ask_through_wires.py PYTHON`, where PYTHON has openpi-client. Prints one line of JSON.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
from vlagents import (
    Chunk,
    ConnectionLost,
    InvalidInput,
    Metadata,
    Observation,
    PartSpec,
    Policy,
    PolicyFailed,
    VlagentsError,
)
from vlagents.websocket import WebsocketClient, WebsocketServer

HERE = Path(__file__).parent


class Sum(Policy):
    """Answers with the sum of the state, a pixel of each image, and the length of the instruction."""

    def metadata(self) -> Metadata:
        """Return the shape of an action."""
        return Metadata(name="sum", action=(PartSpec("joints", 8),), horizon=8, rate=10.0)

    def infer(self, observation: Observation) -> Chunk:
        """Answer."""
        if observation.instruction == "fail":
            raise ValueError("on purpose")
        row = [sum(float(part.sum()) for part in observation.state.values())]
        row += [float(observation.image(name)[0, 0, 0]) for name in observation.images]
        row += [float(len(observation.instruction))]
        return Chunk(np.tile((row + [0.0] * 8)[:8], (8, 1)), 0.1, observation.time)


def theirs_asks_ours(python: str) -> dict[str, str]:
    """Have the stock client ask our server."""
    with WebsocketServer(Sum(), port=0) as server:
        command = [python, str(HERE / "ask_openpi.py"), str(server.address)]
        said = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout
    found = json.loads(said)
    expected = [21.0, *map(float, found["pixels"]), 4.0, 0.0, 0.0]
    assert found["metadata"]["policy"] == "sum", found["metadata"]
    assert found["actions"] == [expected] * 8, (found["actions"], expected)
    assert "on purpose" in found["failed"], found["failed"]
    assert found["numpy"].startswith("1."), found["numpy"]
    return {"openpi_client": found["openpi_client"], "numpy": found["numpy"]}


def failure(client: Policy, observation: Observation, kind: type[VlagentsError]) -> str:
    """Return the words of the error that an observation raises."""
    try:
        client.infer(observation)
    except kind as error:
        return str(error)
    raise AssertionError(f"no {kind.__name__} was raised")


def ours_asks_theirs(python: str) -> dict[str, float]:
    """Have our client ask a server with openpi's layout."""
    serving = subprocess.Popen(
        [python, str(HERE / "openpi_server.py")], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert serving.stdout is not None
        address = serving.stdout.readline().strip()
        random = np.random.default_rng(0)
        images = {name: random.integers(0, 256, (224, 224, 3), np.uint8) for name in ("image", "wrist_image")}
        observation = Observation(images, {"state": np.arange(7.0)}, "pick", time=2.5)
        with WebsocketClient(address) as client:
            assert client.metadata() == Metadata(name="ws", action=()), client.metadata()  # that of openpi has no form
            client.reset("left", "pick")
            assert "give `period`" in failure(client, observation, InvalidInput)
        with WebsocketClient(address, period=0.05) as client:
            chunk = client.infer(observation)
            expected = [21.0, *(float(image[0, 0, 0]) for image in images.values()), 4.0, 0.0, 0.0, 0.0, 0.0]
            assert chunk.actions.tolist() == [expected] * 8, chunk.actions
            assert (chunk.period, chunk.time) == (0.05, 2.5), chunk
            fails = Observation(state={"state": np.zeros(7)}, instruction="fail")
            assert "on purpose" in failure(client, fails, PolicyFailed)
            failure(client, observation, ConnectionLost)
            client.reset()
            assert client.infer(observation).actions.shape == (8, 8)
        return {"infer_ms": round(float(chunk.info["infer_ms"]), 3)}
    finally:
        serving.kill()
        serving.wait()


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)  # errors on purpose
    given = sys.argv[1]
    print(json.dumps({"wire": "openpi", **theirs_asks_ours(given), "ours_asks_theirs": ours_asks_theirs(given)}))
