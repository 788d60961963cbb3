"""The interface of a simulator: what it shows and takes in its own names and units, and its episodes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.metadata import ImageSpec, PartSpec
from vlagents.observation import Observation
from vlagents.record import Count, Hertz, Name, Record
from vlagents.simulators.mapping import SimulatorMapping


@dataclass(frozen=True, kw_only=True)
class Facts(Record):
    """Everything that a simulator says about itself, in its own names and units."""

    name: Name
    """Simulator and task, such as `metaworld:pick-place-v3`."""
    versions: Mapping[str, str]
    """Version of each package that decides what happens."""
    images: tuple[ImageSpec, ...]
    """Its cameras, with the size of their images."""
    state: tuple[PartSpec, ...]
    """Numbers that it shows."""
    action: tuple[PartSpec, ...]
    """Parts of an action, in the order of its numbers."""
    low: tuple[float, ...]
    """Smallest numbers of an action."""
    high: tuple[float, ...]
    """Largest numbers of an action."""
    rate: Hertz
    """Steps per second of simulated time [Hz]."""
    steps: Count
    """Most steps of an episode."""
    starts: int = 0
    """Number of stored starts; 0 if it has none."""
    mapping: SimulatorMapping
    """The mapping that is used if none is given."""


@dataclass(frozen=True)
class Moment:
    """A simulator after the reset, or after a step."""

    observation: Observation
    reward: float = 0.0
    success: bool | None = None
    """Whether the task is done; None if the simulator does not know."""
    is_over: bool = False
    """Whether the simulator ends the episode here."""

    def __post_init__(self) -> None:
        """Check the reward; the observation has checked its numbers.

        Raises:
            InvalidInput: It is not finite.
        """
        if not math.isfinite(self.reward):
            raise InvalidInput(f"The reward is {self.reward!r}; valid is a finite number.")


class Simulator(ABC):
    """One task of a simulator. All calls come from one thread."""

    facts: Facts

    @abstractmethod
    def reset(self, seed: int, start: int | None) -> Moment:
        """Begin an episode; the same arguments begin the same one.

        Args:
            seed: Seed of everything that is drawn.
            start: Number of the stored start; None to draw one.
        """

    @abstractmethod
    def step(self, action: NDArray[np.float64]) -> Moment:
        """Make a step with an action in the simulator's own numbers."""

    def close(self) -> None:  # noqa: B027  a simulator may hold nothing
        """Release everything. A second call does nothing."""
