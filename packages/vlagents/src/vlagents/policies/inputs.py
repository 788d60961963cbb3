"""Pictures and numbers as a model takes them, out of an observation; what does not fit is refused by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.jpeg import Jpeg
from vlagents.metadata import PartSpec
from vlagents.observation import Observation


def picture(observation: Observation, camera: str, height: int = 0, width: int = 0) -> NDArray[np.uint8]:
    """Return a camera's picture, (height, width, 3).

    Args:
        observation: It has the picture.
        camera: Whose.
        height: What the model needs [pixels]; 0 for any.
        width: Alike.

    Raises:
        InvalidInput: There is none, or it has another size.
    """
    image = observation.image(camera)
    _check_size(f"The picture of {camera!r}", image, height, width)
    return image


def goal(observation: Observation, camera: str, height: int = 0, width: int = 0) -> NDArray[np.uint8] | None:
    """Return the goal's picture of a camera, (height, width, 3); None if there is none.

    Raises:
        InvalidInput: It has another size.
    """
    image = observation.goals.get(camera)
    if image is None:
        return None
    array = image.decode() if isinstance(image, Jpeg) else image
    _check_size(f"The goal's picture of {camera!r}", array, height, width)
    return array


def numbers(observation: Observation, parts: Sequence[PartSpec]) -> NDArray[np.float64]:
    """Return parts of the state side by side, (n,).

    Raises:
        InvalidInput: One is missing or has another size.
    """
    found = []
    for part in parts:
        values = np.asarray(observation.state.get(part.name, ()), np.float64)
        if values.shape != (part.size,):
            came = f"has the shape {values.shape}" if part.name in observation.state else "is missing"
            raise InvalidInput(
                f"state[{part.name!r}] {came}; valid is ({part.size},). There are {sorted(observation.state)}."
            )
        found.append(values)
    return np.concatenate(found) if found else np.zeros(0)


def _check_size(what: str, image: NDArray[np.uint8], height: int, width: int) -> None:
    if (height or width) and image.shape[:2] != (height, width):
        raise InvalidInput(
            f"{what} has {image.shape[0]} x {image.shape[1]} pixels; the model takes {height} x {width}. "
            "`vlagents.around.resized.Resized` around the client makes it fit."
        )
