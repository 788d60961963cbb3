"""A policy server with openpi's message layout, by openpi-client's own packing: `python openpi_server.py`.

On connecting it sends its metadata, then answers every observation; what goes wrong is sent as text, and ends the
connection. The policy answers with 8 actions: the sum of `state`, the first pixel of each image, the length of the
prompt; a prompt of "fail" raises. Prints its address, and runs until it is killed.
"""

from __future__ import annotations

import asyncio
import http
import time
import traceback

import numpy as np
from openpi_client import msgpack_numpy
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

METADATA = {"model": "sum", "action_horizon": 8}


def infer(observation: dict) -> dict:
    """Answer an observation."""
    prompt = observation.get("prompt", "")
    if prompt == "fail":
        raise ValueError("on purpose")
    images = [value for value in observation.values() if isinstance(value, np.ndarray) and value.ndim == 3]
    state = sum(
        float(value.sum()) for value in observation.values() if isinstance(value, np.ndarray) and value.ndim < 3
    )
    row = [state, *(float(image[0, 0, 0]) for image in images), float(len(prompt))]
    return {"actions": np.tile((row + [0.0] * 8)[:8], (8, 1))}


async def answer(connection: ServerConnection) -> None:
    """Answer one connection until it ends."""
    packer = msgpack_numpy.Packer()
    await connection.send(packer.pack(METADATA))
    while True:
        try:
            observation = msgpack_numpy.unpackb(await connection.recv())
            begin = time.monotonic()
            result = infer(observation)
            result["server_timing"] = {"infer_ms": 1e3 * (time.monotonic() - begin)}
            await connection.send(packer.pack(result))
        except ConnectionClosed:
            return
        except Exception:
            await connection.send(traceback.format_exc())
            await connection.close(code=1011, reason="Internal server error.")
            raise


def health(connection: ServerConnection, request):
    """Answer GET /healthz."""
    return connection.respond(http.HTTPStatus.OK, "OK\n") if request.path == "/healthz" else None


async def main() -> None:
    """Serve."""
    options = {"compression": None, "max_size": None, "process_request": health}
    async with serve(answer, "127.0.0.1", 0, **options) as server:
        print(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", flush=True)
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
