"""Calls and answers as plain values.

A connection begins with `hello`, which has the token. Then the client may call `reset`, `infer`, `forget` and `ping`,
each with a number that the answer repeats.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, InvalidInput
from vlagents.jpeg import Jpeg
from vlagents.observation import Observation
from vlagents.record import Seconds, read

VERSION = 1
"""Version of the calls; another one is refused."""


@dataclass(frozen=True)
class Call:
    """A call of a client; each kind of call uses some of the fields."""

    call: str
    within: Seconds | None = None
    """Longest time that the client waits for the answer [s]."""
    version: Any = None
    token: Any = None
    session: Annotated[str, Meta(max_length=200)] = ""
    instruction: Annotated[str, Meta(max_length=100_000)] = ""
    seed: Annotated[int, Meta(ge=0)] | None = None
    observation: Any = None


@dataclass(frozen=True)
class _Observation:
    images: dict[str, Any] = field(default_factory=dict)
    goals: dict[str, Any] = field(default_factory=dict)
    state: dict[str, np.ndarray] = field(default_factory=dict)
    instruction: str = ""
    time: float = 0.0
    session: str = ""


def observation_to_values(observation: Observation) -> dict[str, Any]:
    """Return an observation as plain values."""
    return {
        "images": {name: _image_to_values(image) for name, image in observation.images.items()},
        "goals": {name: _image_to_values(image) for name, image in observation.goals.items()},
        "state": {name: np.asarray(values) for name, values in observation.state.items()},
        "instruction": observation.instruction,
        "time": float(observation.time),
        "session": observation.session,
    }


def observation_from_values(values: object) -> Observation:
    """Read what `observation_to_values` made.

    Raises:
        InvalidInput: Something is missing or wrong.
    """
    found = vars(read(_Observation, values)).copy()
    for what in ("images", "goals"):
        found[what] = {name: _image(name, image) for name, image in found[what].items()}
    return Observation(**found)


def chunk_to_values(chunk: Chunk) -> dict[str, Any]:
    """Return a chunk as plain values."""
    return {
        "actions": chunk.actions,
        "period": float(chunk.period),
        "time": float(chunk.time),
        "info": {name: value if isinstance(value, str) else float(value) for name, value in chunk.info.items()},
    }


def chunk_from_values(values: object) -> Chunk:
    """Read what `chunk_to_values` made.

    Raises:
        BadMessage: The values are no chunk.
    """
    try:
        return read(Chunk, values)
    except InvalidInput as error:
        raise BadMessage(f"The answer is no chunk: {error}") from error


def _image_to_values(image: Any) -> Any:
    return {"jpeg": np.frombuffer(image.data, np.uint8)} if isinstance(image, Jpeg) else image


def _image(name: str, image: Any) -> Any:
    if not isinstance(image, dict):
        return image
    data = image.get("jpeg")
    if not isinstance(data, np.ndarray) or data.dtype != np.uint8 or data.ndim != 1:
        raise InvalidInput(f"The JPEG of image {name!r} is not bytes.")
    return Jpeg(data.tobytes())
