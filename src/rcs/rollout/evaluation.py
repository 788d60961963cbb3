"""The recipe of an evaluation, and its results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rcs_data.ledger import Pairs
from rcs_data.ledger.condition import key_of, named
from rcs_data.options import require_whole
from rcs_data.read.verdicts import wilson_interval

from rcs.agents.identity import Identity
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.collection import Attempt, seed_of
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.foreign import ForeignEnv, ForeignSimulator
from rcs.setups.make import make

UNSEEN = 1 << 60
"""First seed of evaluations: collections have those below 2**32, training those from 2**61 on."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The recipe of an evaluation."""

    setup: Setup
    simulator: ForeignSimulator | None = None
    """The simulator of another project that `setup` is of; None for the one here, or for real devices."""
    agent: Any = None
    """A class or function that makes an agent, its name or `module:Class`, the path of a checkpoint, the address of a
    policy, or an `Identified`; None for the expert of the task. In one process also an agent."""
    name: str | None = None
    """Name of the agent in the ledger; None for its own."""
    tags: Mapping[str, str] = field(default_factory=dict[str, str])
    """Names and values for the ledger, by which figures can be drawn, such as `{"mix": "half real"}`."""
    episodes: int = 50
    seed: int = 0
    """Same seed, same episodes; different seeds share none. No collection and no training has any of them."""
    repeat: int = 0
    """How many more times to run each episode, even if the ledger has it."""
    against: str | None = None
    """Another agent in the same ledger, by name or hash, for `until`."""
    until: float | None = None
    """Level, such as 0.05: end as soon as the seeds shared with `against` show which agent is better."""
    workers: int = 1
    """Processes; one works in this process. With `ray`, 0 is one per CPU of the cluster. A simulator at an address
    has one."""
    ray: str | None = None
    """Address of a Ray cluster for the processes: `auto` for the one that this machine is a part of, or `host:port`;
    None for this machine, without Ray."""
    out: Path | None = None
    """Folder of a ledger that takes the episodes: those that are there already are not run again; None for none."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is not valid, an option lacks another one, or the robot is to place the objects.
        """
        fewest = 1 if self.ray is None else 0
        for name, least in (("episodes", 1), ("seed", 0), ("repeat", 0), ("workers", fewest)):
            require_whole(name, getattr(self, name), least)
        if self.until is not None and not 0 < self.until < 1:
            raise InvalidSetup(f"until is {self.until!r}; valid is a level between 0 and 1, such as 0.05.")
        if (self.until is None) != (self.against is None) or (self.against is not None and self.out is None):
            raise InvalidSetup(
                "until, against and out belong together: a level, another agent, and the ledger with both."
            )
        if self.setup.task_options.get("placed_by") == "robot":
            raise InvalidSetup(
                "placed_by is 'robot', which only a collection does: in an evaluation the reset places the objects, or "
                "beside a real robot a person. Use placed_by='reset'."
            )
        is_alone = self.workers == 1 and self.ray is None
        if self.simulator is not None and self.simulator.is_address and not is_alone:
            raise InvalidSetup(
                f"The simulator at {self.simulator.name} serves one process at a time; workers is {self.workers} and "
                f"ray is {self.ray!r}. Use workers=1 and no ray, or the name of the simulator, which then every "
                "process starts for itself."
            )

    def make(self) -> Env:
        """Return a new environment for the episodes."""
        return make(self.setup) if self.simulator is None else ForeignEnv(self.simulator)

    @property
    def numbers(self) -> range:
        """Numbers of all episodes: repetitions come after."""
        return range(self.episodes * (1 + self.repeat))

    def repeat_of(self, number: int) -> int:
        """Return which repetition an episode is; 0 for the first time."""
        return number // self.episodes

    def seed_of(self, number: int) -> int:
        """Return the seed of an episode."""
        return UNSEEN + seed_of(self.seed, number % self.episodes)

    def name_of(self, condition: str, number: int) -> str:
        """Return the name of an episode: of its row, its film and its recording.

        Args:
            condition: The hash of its condition.
            number: Its number.
        """
        return named(key_of(condition, self.seed_of(number)), self.repeat_of(number))


@dataclass(kw_only=True)
class Summary:
    """Results of an evaluation or a collection."""

    attempts: list[Attempt] = field(default_factory=list[Attempt])
    """Attempts in the order of their ends, after those that were there before; in the end those of other processes."""
    episodes: int | None = None
    """Number of episodes; attempts with larger numbers repeat them. None where nothing is repeated."""
    is_interrupted: bool = False
    """Set it to end the evaluation after the running episodes."""
    is_decided: bool = False
    """Whether the episodes show which agent is better, where that ends an evaluation."""
    pairs: Pairs | None = None
    """Verdicts of this agent, A, and of the other, B, by which that is decided; None before the end."""
    identity: Identity | None = None
    """The agent, once an evaluation with a ledger has begun."""
    condition: str = ""
    """The hash of its condition in the ledger."""

    @property
    def found(self) -> int:
        """How many of the attempts were not run, but found in the ledger."""
        return sum(attempt.is_found for attempt in self.attempts)

    @property
    def results(self) -> list[EpisodeResult]:
        """The results without repetitions, in the order of the attempts' numbers."""
        ordered = sorted(self.attempts, key=lambda attempt: attempt.number)
        return [attempt.result for attempt in ordered if self.episodes is None or attempt.number < self.episodes]

    @property
    def repetitions(self) -> list[Attempt]:
        """The attempts that repeat an episode."""
        return [one for one in self.attempts if self.episodes is not None and one.number >= self.episodes]

    @property
    def changed(self) -> int:
        """Number of repetitions with another verdict than their episode had the first time."""
        verdicts = {attempt.number: attempt.result.success for attempt in self.attempts}
        again = [(one.number % (self.episodes or 1), one.result.success) for one in self.repetitions]
        return sum(number in verdicts and verdicts[number] is not verdict for number, verdict in again)

    @property
    def judged(self) -> int:
        """Episodes with a verdict."""
        return sum(result.success is not None for result in self.results)

    @property
    def successes(self) -> int:
        """Episodes in which the task was done."""
        return sum(bool(result.success) for result in self.results)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % Wilson interval of the success rate, 0 … 1; all of it if nothing was judged."""
        return wilson_interval(self.successes, self.judged)

    @property
    def failures(self) -> Counter[str]:
        """Number of failures by class."""
        return Counter(result.failure for result in self.results if result.failure is not None)
