"""What is said on a wire: calls and answers as plain values, and what they mean to a policy.

A connection begins with `hello`, which has the token and what the robot offers. Then it may ask for `metadata`,
`reset`, `infer`, `forget` and `ping`, each with a number that the answer repeats.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, InvalidInput, as_failure
from vlagents.jpeg import Jpeg
from vlagents.observation import Observation

VERSION = 1
"""Of what is said; another one is refused."""


def observation_to_values(observation: Observation) -> dict[str, Any]:
    """Return an observation as a message has it."""
    return {
        "images": {name: _image_to_values(image) for name, image in observation.images.items()},
        "goals": {name: _image_to_values(image) for name, image in observation.goals.items()},
        "state": {name: np.asarray(values) for name, values in observation.state.items()},
        "instruction": observation.instruction,
        "time": float(observation.time),
        "times": {name: float(time) for name, time in observation.times.items()},
        "session": observation.session,
        **({} if observation.previous is None else {"previous": observation.previous, "frozen": observation.frozen}),
    }


def observation_from_values(values: object) -> Observation:
    """Read what `observation_to_values` made.

    Raises:
        InvalidInput: Something is missing or wrong.
    """
    given = mapping("observation", values)
    return Observation(
        images={name: _image(name, image) for name, image in mapping("images", given.get("images", {})).items()},
        goals={name: _image(name, image) for name, image in mapping("goals", given.get("goals", {})).items()},
        state={name: _numbers(name, part) for name, part in mapping("state", given.get("state", {})).items()},
        instruction=given.get("instruction", ""),
        time=_number("time", given.get("time", 0.0)),
        times={name: _number(name, time) for name, time in mapping("times", given.get("times", {})).items()},
        session=given.get("session", ""),
        previous=None if given.get("previous") is None else _numbers("previous", given["previous"]),
        frozen=given.get("frozen", 0),
    )


def chunk_to_values(chunk: Chunk) -> dict[str, Any]:
    """Return a chunk as a message has it."""
    return {
        "actions": chunk.actions,
        "period": float(chunk.period),
        "time": float(chunk.time),
        "info": {name: value if isinstance(value, str) else float(value) for name, value in chunk.info.items()},
    }


def chunk_from_values(values: object) -> Chunk:
    """Read what `chunk_to_values` made.

    Raises:
        BadMessage: It is none.
    """
    try:
        given = mapping("chunk", values)
        actions = given.get("actions")
        if not isinstance(actions, np.ndarray):
            raise InvalidInput("A chunk has no actions.")
        return Chunk(
            actions=np.array(actions, np.float64),
            period=_number("period", given.get("period")),
            time=_number("time", given.get("time", 0.0)),
            info=dict(mapping("info", given.get("info", {}))),
        )
    except InvalidInput as error:
        raise BadMessage(f"The answer is no chunk: {error}") from error


def failure(number: object, error: BaseException) -> dict[str, Any]:
    """Return the answer that says what went wrong with a call."""
    return {"id": number, "error": as_failure(error)}


def mapping(what: str, values: object) -> Mapping[str, Any]:
    """Return values if they are a dictionary with str as keys.

    Raises:
        InvalidInput: They are not.
    """
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        raise InvalidInput(f"{what} is {type(values).__name__}; valid is a dictionary with names as keys.")
    return values


def _image_to_values(image: Any) -> Any:
    return {"jpeg": np.frombuffer(image.data, np.uint8)} if isinstance(image, Jpeg) else image


def _image(name: str, image: object) -> Any:
    if isinstance(image, Mapping):
        data = image.get("jpeg")
        if not isinstance(data, np.ndarray) or data.dtype != np.uint8 or data.ndim != 1:
            raise InvalidInput(f"The JPEG of image {name!r} is not bytes.")
        return Jpeg(data.tobytes())
    return image


def _numbers(name: str, part: object) -> Any:
    if not isinstance(part, np.ndarray):
        raise InvalidInput(f"{name!r} is {type(part).__name__}; valid is an array.")
    return part


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InvalidInput(f"{name} is {value!r:.80}; valid is a number.")
    return float(value)
