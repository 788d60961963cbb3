"""The recipe of a collection, the result of an attempt, and how far a collection is."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.files.feature import Colour
from rcs_data.options import require_whole

from rcs.envs.observers.dataset_info import require_recordable
from rcs.envs.setup import Setup
from rcs.envs.step.approach import SPEED
from rcs.errors import InvalidSetup
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.placing import is_placed_by_robot

# Attempts after which a collection of successes alone gives up: without a single one, and per episode wanted.
_MOST_WITHOUT_SUCCESS = 100
_MOST_PER_EPISODE = 20


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Which episodes a dataset keeps, and how."""

    episodes: int = 20
    """Number of episodes in the finished dataset; only those with a verdict count."""
    only_success: bool = False
    """Keep successful episodes only, and try until there are enough."""
    most_attempts: int | None = None
    """Attempts after which `only_success` gives up with an error; by default 100 without a single success, and else 20
    for each episode, and at least 100."""
    colour: Colour = "jpeg"
    """Encoding of colour frames. `lossless` takes as much space as `jpeg`, with sensor noise six times as much."""
    jpeg_quality: int = 95
    """JPEG quality of colour frames, 1 to 100."""
    home_speed: float = SPEED
    """Largest speed of a joint of real arms on their way home, as a share of its limit."""


@dataclass(frozen=True, kw_only=True)
class Collection(Kept):
    """The recipe of a dataset."""

    setup: Setup
    out: Path
    """The dataset's folder."""
    seed: int = 0
    """Random seed; the same seed gives the same data."""
    workers: int = 1
    """Processes; one works in this process. With `ray`, 0 is one per CPU of the cluster."""
    ray: str | None = None
    """Address of a Ray cluster for the processes: `auto` for the one that this machine is a part of, or `host:port`;
    None for this machine, without Ray. Ray transfers the episodes; other machines need not see `out`."""
    agent: Any = None
    """An agent's class or name, `module:Class`, the path of a checkpoint, or the address of a policy; None for the
    expert of the task."""
    hardware: Any = None
    """The real devices, as in `rcs.make`; None for simulation alone. Real robots have one process, and a supervisor."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is not valid.
        """
        fewest = 1 if self.ray is None else 0
        for name, least in (("episodes", 1), ("seed", 0), ("workers", fewest), ("most_attempts", 1)):
            value = getattr(self, name)
            if name != "most_attempts" or value is not None:
                require_whole(name, value, least)
        if self.hardware is not None and (self.workers != 1 or self.ray is not None):
            raise InvalidSetup(
                f"Real robots are driven by one process of this machine; workers is {self.workers} and ray is "
                f"{self.ray!r}. Use workers=1 and no ray with hardware."
            )
        require_recordable(self.setup)
        if is_placed_by_robot(self.setup) and (self.workers != 1 or self.ray is not None):
            raise InvalidSetup(
                "placed_by is 'robot', so that an episode begins where the one before ended; workers is "
                f"{self.workers} and ray is {self.ray!r}. Use workers=1 and no ray."
            )

    def attempts_before_giving_up(self, kept: int) -> int:
        """Return after how many attempts a collection of successes alone gives up, when some episodes are kept."""
        if self.most_attempts is not None:
            return self.most_attempts
        return _MOST_WITHOUT_SUCCESS if kept == 0 else max(_MOST_WITHOUT_SUCCESS, _MOST_PER_EPISODE * self.episodes)

    def seed_of(self, attempt: int) -> int:
        """Return the seed of an attempt; collections with different seeds share none."""
        return seed_of(self.seed, attempt)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of an episode of a collection or evaluation; different seeds share no episodes."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One finished attempt."""

    number: int
    result: EpisodeResult
    weights: str | None = None
    """SHA-256 of the weights that acted; None if there are none, or that is not known."""
    is_lost: bool = False
    """Whether the connection to the policy was lost in it."""
    latencies: tuple[float, ...] = field(default=(), compare=False)
    """How long each answer of a policy took [s]."""
    seconds: float = field(default=0.0, compare=False)
    """Duration by the clock [s]."""
    is_found: bool = field(default=False, compare=False)
    """Whether it was not made here, but is in the ledger."""


@dataclass
class Progress:
    """The progress of a collection."""

    kept: int = 0
    """Episodes in the dataset, including those of earlier runs."""
    found: int = 0
    """Complete episodes at the start of this run."""
    again: int = 0
    """Attempts that a kill cut short and that are made again from the start."""
    attempts: list[Attempt] = field(default_factory=list[Attempt])
    """Attempts of this run, in the order of their ends."""
    is_interrupted: bool = False
    seconds: float = 0.0
    """Wall time of this run [s]."""


def episode_id(number: int) -> str:
    """Return the id of an attempt's episode."""
    return f"{number:06d}"
