"""Policies around a policy: `Around` passes everything on, `Resized` changes the size of images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlagents.chunk import Chunk
from vlagents.jpeg import Jpeg
from vlagents.metadata import ImageSpec, Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy


class Around(Policy):
    """Passes every call on to another policy; a subclass changes what it is about."""

    def __init__(self, inside: Policy) -> None:
        """Wrap a policy; it is closed with this one."""
        self.inside = inside

    def metadata(self) -> Metadata:
        """Return the metadata of the policy inside."""
        return self.inside.metadata()

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode inside."""
        self.inside.reset(session, instruction, seed=seed)

    def infer(self, observation: Observation) -> Chunk:
        """Return the chunk of the policy inside."""
        return self.inside.infer(observation)

    def forget(self, session: str) -> None:
        """Have the policy inside forget a session."""
        self.inside.forget(session)

    def close(self) -> None:
        """Close the policy inside."""
        self.inside.close()


class Resized(Around):
    """Makes pictures as large as the policy inside needs: scaled to fit, centred, black around them.

    On the robot's side this spares the wire: a 224 x 224 picture is a twentieth of one with 1280 x 720.
    """

    def metadata(self) -> Metadata:
        """Return what the policy inside needs, with pictures of any size."""
        inside = self.inside.metadata()
        return replace(inside, images=tuple(ImageSpec(image.name) for image in inside.images))

    def infer(self, observation: Observation) -> Chunk:
        """Resize, and ask."""
        sizes = {image.name: (image.height, image.width) for image in self.inside.metadata().images}
        images, goals = (
            {
                name: _fitted(image, *sizes[name]) if all(sizes.get(name, (0, 0))) else image
                for name, image in shown.items()
            }
            for shown in (observation.images, observation.goals)
        )
        return self.inside.infer(replace(observation, images=images, goals=goals))


def resized(image: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """Return a picture of another size: each new pixel is the mean of what it covers, or between its neighbours.

    It is scaled as a whole until it fits, and put in the middle; the rest is black.

    Args:
        image: (height, width, 3).
        height: Height of the result [pixels].
        width: Width of the result [pixels].
    """
    if image.shape[:2] == (height, width):
        return image
    scale = min(height / image.shape[0], width / image.shape[1])
    inner_height, inner_width = (max(1, round(scale * n)) for n in image.shape[:2])
    rows, columns = _weights(image.shape[0], inner_height), _weights(image.shape[1], inner_width)
    # Rows first: the picture shrinks before the larger product.
    half = np.tensordot(rows, image.astype(np.float32), axes=(1, 0))
    inner = np.einsum("wc,hcx->hwx", columns, half, optimize=True)
    top, left = (height - inner_height) // 2, (width - inner_width) // 2
    result = np.zeros((height, width, 3), np.uint8)
    result[top : top + inner_height, left : left + inner_width] = np.clip(np.rint(inner), 0, 255)
    return result


def _fitted(image: NDArray[np.uint8] | Jpeg, height: int, width: int) -> NDArray[np.uint8]:
    return resized(image.decode() if isinstance(image, Jpeg) else image, height, width)


def _weights(given: int, wanted: int) -> NDArray[np.float32]:
    """Return how much each old pixel counts in each new one, (wanted, given): a triangle as wide as a new pixel."""
    centres = (np.arange(wanted) + 0.5) * given / wanted - 0.5
    support = max(given / wanted, 1.0)
    weights = np.maximum(1.0 - np.abs(np.arange(given)[None, :] - centres[:, None]) / support, 0.0)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
