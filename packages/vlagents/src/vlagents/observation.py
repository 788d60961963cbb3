"""An observation as a policy sees it: images, the robot's state by named parts, and an instruction."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.jpeg import Jpeg
from vlagents.metadata import PartSpec


@dataclass(frozen=True)
class Observation:
    """One moment as a robot sees it.

    A server hands a policy arrays that are the policy's own, to write and to keep.
    """

    images: Mapping[str, NDArray[np.uint8] | Jpeg] = field(default_factory=dict)
    """Images by camera: RGB, uint8, (height, width, 3), or compressed."""
    state: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """Numbers by part, such as `joints` [rad] or `gripper` (0 closed … 1 open), (n,) each. The metadata have units."""
    instruction: str = ""
    """The task in words. An empty instruction stands for that of the session's `reset`."""
    goals: Mapping[str, NDArray[np.uint8] | Jpeg] = field(default_factory=dict)
    """Images of the goal, by camera."""
    time: float = 0.0
    """Time of the observation by the robot's clock [s]. A chunk's actions count from it."""
    session: str = ""
    """Name of the robot or copy. A policy keeps its memory of each session apart."""

    def __post_init__(self) -> None:
        """Check types and shapes, so that a mistake is found where it is made.

        Raises:
            InvalidInput: One is wrong; the message names it.
        """
        for what, images in (("images", self.images), ("goals", self.goals)):
            for name, image in images.items():
                _check_image(f"{what}[{name!r}]", image)
        for name, values in self.state.items():
            array = np.asarray(values)
            if array.dtype.kind not in "fiub" or array.ndim != 1:
                raise InvalidInput(
                    f"state[{name!r}] is {array.dtype} of shape {array.shape}; valid are numbers of shape (n,)."
                )
            if not np.isfinite(array).all():
                raise InvalidInput(f"state[{name!r}] has a value that is not finite: {array}.")
        if not np.isfinite(self.time):
            raise InvalidInput(f"time is {self.time!r}; valid is a finite number of seconds.")
        for name in ("instruction", "session"):
            if not isinstance(getattr(self, name), str):
                raise InvalidInput(f"{name} is {getattr(self, name)!r}; valid is a str.")

    def of_session(self, session: str) -> Observation:
        """Return the same observation as another session's. Nothing that was checked once is checked again."""
        other = copy.copy(self)
        object.__setattr__(other, "session", session)
        return other

    def image(self, name: str, height: int = 0, width: int = 0) -> NDArray[np.uint8]:
        """Return a camera's picture as an array (height, width, 3), decompressed where needed.

        Args:
            name: Name of the camera.
            height: Height that a model needs [pixels]; 0 for any.
            width: Width that a model needs [pixels]; 0 for any.

        Raises:
            InvalidInput: There is no such camera, its JPEG is damaged, or the picture has another size.
        """
        if name not in self.images:
            raise InvalidInput(f"There is no image {name!r}; there are {sorted(self.images)}.")
        return _sized(f"The image of {name!r}", self.images[name], height, width)

    def goal(self, name: str, height: int = 0, width: int = 0) -> NDArray[np.uint8] | None:
        """Return the goal's picture of a camera, as `image` does; None if there is none.

        Raises:
            InvalidInput: Its JPEG is damaged, or it has another size.
        """
        image = self.goals.get(name)
        return None if image is None else _sized(f"The goal's image of {name!r}", image, height, width)

    def numbers(self, parts: Sequence[PartSpec]) -> NDArray[np.float64]:
        """Return parts of the state side by side, (n,).

        Raises:
            InvalidInput: One is missing or has another size.
        """
        found = []
        for part in parts:
            values = np.asarray(self.state.get(part.name, ()), np.float64)
            if values.shape != (part.size,):
                fault = f"has the shape {values.shape}" if part.name in self.state else "is missing"
                raise InvalidInput(
                    f"state[{part.name!r}] {fault}; valid is ({part.size},). There are {sorted(self.state)}."
                )
            found.append(values)
        return np.concatenate(found) if found else np.zeros(0)


def _sized(what: str, image: NDArray[np.uint8] | Jpeg, height: int, width: int) -> NDArray[np.uint8]:
    array = image.decode() if isinstance(image, Jpeg) else image
    if (height or width) and array.shape[:2] != (height, width):
        raise InvalidInput(
            f"{what} has {array.shape[0]} x {array.shape[1]} pixels; the model takes {height} x {width}. "
            "`vlagents.around.Resized` around the client makes it fit."
        )
    return array


def _check_image(name: str, image: object) -> None:
    if isinstance(image, Jpeg):
        return
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        given = f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else repr(type(image).__name__)
        raise InvalidInput(f"{name} is {given}; valid is uint8 of shape (height, width, 3), or a Jpeg.")
