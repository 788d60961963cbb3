"""Images and numbers of an observation as a model takes them; an input that does not fit is refused by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.jpeg import Jpeg
from vlagents.metadata import PartSpec
from vlagents.observation import Observation


def picture(observation: Observation, camera: str, height: int = 0, width: int = 0) -> NDArray[np.uint8]:
    """Return a camera's image, (height, width, 3).

    Args:
        observation: It has the image.
        camera: Name of the camera.
        height: Height that the model needs [pixels]; 0 for any.
        width: Width that the model needs [pixels]; 0 for any.

    Raises:
        InvalidInput: There is no image, or it has another size.
    """
    return _sized(f"The image of {camera!r}", observation.image(camera), height, width)


def goal(observation: Observation, camera: str, height: int = 0, width: int = 0) -> NDArray[np.uint8] | None:
    """Return the goal's image of a camera, (height, width, 3); None if there is none.

    Raises:
        InvalidInput: It has another size.
    """
    image = observation.goals.get(camera)
    array = image.decode() if isinstance(image, Jpeg) else image
    return None if array is None else _sized(f"The goal's image of {camera!r}", array, height, width)


def numbers(observation: Observation, parts: Sequence[PartSpec]) -> NDArray[np.float64]:
    """Return parts of the state side by side, (n,).

    Raises:
        InvalidInput: One is missing or has another size.
    """
    found = []
    for part in parts:
        values = np.asarray(observation.state.get(part.name, ()), np.float64)
        if values.shape != (part.size,):
            fault = f"has the shape {values.shape}" if part.name in observation.state else "is missing"
            raise InvalidInput(
                f"state[{part.name!r}] {fault}; valid is ({part.size},). There are {sorted(observation.state)}."
            )
        found.append(values)
    return np.concatenate(found) if found else np.zeros(0)


def _sized(what: str, image: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    if (height or width) and image.shape[:2] != (height, width):
        raise InvalidInput(
            f"{what} has {image.shape[0]} x {image.shape[1]} pixels; the model takes {height} x {width}. "
            "`vlagents.around.Resized` around the client makes it fit."
        )
    return image
