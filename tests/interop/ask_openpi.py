"""Asks a server with the stock client of openpi-client: `python ask_openpi.py ADDRESS [CALLS]`.

Prints one line of JSON: the metadata's policy, the first chunk of a small observation, and with CALLS the times of so
many calls of two images of 224 x 224 and two of 1280 x 720 pixels [s].
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

SIZES = {"left": (224, 224), "right": (224, 224), "front": (720, 1280), "side": (720, 1280)}


def main() -> dict[str, object]:
    """Ask."""
    client = WebsocketClientPolicy(sys.argv[1])
    random = np.random.default_rng(0)
    images = {name: random.integers(0, 256, (*size, 3), np.uint8) for name, size in SIZES.items()}
    observation = {**images, "state": np.arange(7.0), "prompt": "pick"}
    client.reset()
    first = client.infer(observation)
    times = []
    for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 0):
        begin = time.perf_counter()
        client.infer(observation)
        times.append(time.perf_counter() - begin)
    failed = ""
    try:
        client.infer({"state": np.zeros(7), "prompt": "fail"})
    except RuntimeError as error:
        failed = str(error)
    return {
        "openpi_client": version("openpi-client"),
        "numpy": np.__version__,
        "metadata": client.get_server_metadata(),
        "actions": first["actions"].tolist(),
        "pixels": [int(image[0, 0, 0]) for image in images.values()],
        "failed": failed,
        "times": times,
    }


if __name__ == "__main__":
    print(json.dumps(main(), default=str))
