"""The interface of an observer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.spaces import Arrays, Observation
from rcs.errors import InvalidSetup


@dataclass(frozen=True)
class Note:
    """A value beside steps that `env.note` gives: a number, a vector or a word. Steps without it have NaN, or no word.

    Raises:
        InvalidSetup: It is both a vector and a word, or a word is empty or there twice.
    """

    name: str
    """Its name."""
    size: int | None = None
    """Length of a vector; None for a single number or a word."""
    words: tuple[str, ...] = ()
    """The words that it may have; none for numbers."""
    unit: str = ""
    """Unit of numbers, for people."""

    def __post_init__(self) -> None:
        """Check it."""
        if self.words and self.size is not None:
            raise InvalidSetup(f"The note {self.name!r} has a size and words; valid is one of them.")
        if len({*self.words, ""}) != len(self.words) + 1 or len(self.words) > 255:
            raise InvalidSetup(f"The words of the note {self.name!r} are {self.words}; each is there once, none empty.")


@dataclass(frozen=True, kw_only=True)
class Transition:
    """One step of an environment, or the start of an episode.

    After a step in which the simulation diverged, observation, state and poses are those of the moment before.
    """

    observation: Observation
    action: Arrays | None
    """The action as it was given; None for the first observation of an episode."""
    executed: Arrays | None
    """The action as it was sent to the devices."""
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    time: float
    """When the observation was complete [s], on the monotonic clock."""
    command_time: float | None = None
    """When the targets of this step were sent [s], on the monotonic clock; None for the start of an episode."""
    after_hold: bool = False
    """Whether the devices were made to hold since the last step, or in this one because a gate refused it."""
    capture_times: dict[str, float] = field(default_factory=dict[str, float])
    """When each sensor was read [s], on the monotonic clock, by the sensor's key such as `frames/wrist`."""
    device_times: dict[str, float] = field(default_factory=dict[str, float])
    """The same on the clocks of real devices [s]; NaN for those without one."""
    sim_state: NDArray[np.float64] | None = None
    """The simulation's whole state, (state_size,); None on hardware."""
    objects: dict[str, NDArray[np.float64]] = field(default_factory=dict[str, NDArray[np.float64]])
    """Poses of the task's objects by name, (7,): translation [m] and quaternion xyzw in the base frame (with several
    robots: in the scene); empty on hardware."""
    notes: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Values passed to `env.note` since the last step."""


class Observer(ABC):
    """Sees every transition of one environment."""

    @abstractmethod
    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Handle a new episode."""

    @abstractmethod
    def on_step(self, transition: Transition) -> None:
        """Handle a step."""

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:  # noqa: B027  most observers do not mind
        """Handle the abort of an episode; all devices hold. A reset or `close` follows.

        Args:
            end: `fault` when a device entered its fault state, `exception` when a step raised an error.
            reasons: The faults by device, or the error's message by its class.
        """

    def info(self) -> Mapping[str, Any]:
        """Return entries for `info` of the present step, in every step of a single environment.

        It is called before the observer sees the step, and must return at once.
        """
        return {}

    def close(self) -> None:  # noqa: B027  most observers hold nothing
        """Release all resources; closing twice is harmless."""
