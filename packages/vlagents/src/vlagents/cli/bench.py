"""How long an answer takes."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence

import numpy as np

from vlagents.errors import InvalidInput
from vlagents.observation import Observation
from vlagents.policy import Policy


def bench(client: Policy, *, calls: int = 200, images: Sequence[str] = ()) -> str:
    """Ask so many times, and return a JSON object with the median and the 99th percentile [ms].

    Args:
        client: Whom to ask.
        calls: How many times, after ten that do not count.
        images: Pictures of each call, as `HEIGHTxWIDTH`; by default those that the policy needs.

    Raises:
        InvalidInput: A size is none.
    """
    metadata = client.metadata()
    random = np.random.default_rng(0)
    sizes = {f"image {i}": _size(text) for i, text in enumerate(images)} or {
        image.name: (image.height or 224, image.width or 224) for image in metadata.images
    }
    observation = Observation(
        images={name: random.integers(0, 256, (*size, 3), np.uint8) for name, size in sizes.items()},
        state={part.name: np.zeros(part.size) for part in metadata.state},
        instruction="measure",
        session="bench",
    )
    client.reset("bench", "measure")
    seconds = []
    for _ in range(calls + 10):
        begin = time.perf_counter()
        client.infer(observation)
        seconds.append(time.perf_counter() - begin)
    client.forget("bench")
    half, most = 1e3 * np.quantile(seconds[10:], [0.5, 0.99])
    return json.dumps({"calls": calls, "p50_ms": round(float(half), 3), "p99_ms": round(float(most), 3)})


def _size(text: str) -> tuple[int, int]:
    height, _, width = text.partition("x")
    if not (height.isdecimal() and width.isdecimal() and int(height) * int(width)):
        raise InvalidInput(f"An image is {text!r}; valid is HEIGHTxWIDTH, such as 224x224.")
    return int(height), int(width)
