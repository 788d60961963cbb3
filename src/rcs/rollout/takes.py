"""The takes of a person's session: begun, judged, discarded, and listed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rcs.envs.observers.recorder import Recorder
from rcs.errors import CorruptEpisode, DatasetError, WrongOrder
from rcs.rollout.latency import Latency

WORDS: Mapping[bool | None, str] = {True: "success", False: "failure", None: "no verdict"}
"""Verdicts in words."""


@dataclass
class LoopStatistics:
    """How well a loop has kept its rate."""

    frequency: float
    """The rate it should have [Hz]."""
    steps: int = 0
    """Steps with a period: the time since the end of the step before."""
    mean: float = 0.0
    """Mean of the periods [s]."""
    squares: float = 0.0
    """Sum of the squares of their deviations from it [s²]."""
    late: int = 0
    """Steps that ended later than due by more than a tenth of a period."""
    oldest: dict[str, float] = field(default_factory=dict[str, float])
    """The largest age of each sensor's reading at the end of a step [s]."""

    def add(self, period: float, info: Mapping[str, Any]) -> None:
        """Count a step.

        Args:
            period: Time since the end of the step before [s].
            info: Info of the step.
        """
        # B. P. Welford, Technometrics 4 (1962), 419-420; a list would take longer to tell with every hour.
        self.steps += 1
        off = period - self.mean
        self.mean += off / self.steps
        self.squares += off * (period - self.mean)
        self.late += float(info.get("late", 0.0)) > 0.1 / self.frequency
        for key, age in info.get("ages", {}).items():
            self.oldest[key] = max(self.oldest.get(key, 0.0), float(age))

    @property
    def rates(self) -> tuple[float, float]:
        """Mean of the rate, and its deviation by that of the periods [Hz]; NaN before the second step."""
        if not self.steps:
            return np.nan, np.nan
        return 1.0 / self.mean, math.sqrt(self.squares / self.steps) / self.mean**2

    def to_json(self) -> dict[str, Any]:
        """Return the figures, to be stored with a take."""
        mean, deviation = self.rates
        is_known = bool(self.steps)
        return {
            "steps": self.steps,
            "rate": mean if is_known else None,
            "rate_deviation": deviation if is_known else None,
            "late": self.late,
        }

    def __str__(self) -> str:
        """Return the figures in a line."""
        mean, deviation = self.rates
        ages = ", ".join(f"{key} {1e3 * age:.0f} ms" for key, age in self.oldest.items())
        text = f"; oldest: {ages}" if ages else ""
        return f"{self.steps} steps at {mean:.2f} ± {deviation:.2f} Hz, {self.late} late{text}"


@dataclass(frozen=True, kw_only=True)
class Take:
    """A take that has ended."""

    id: str
    success: bool | None
    """The verdict; None for none."""
    rows: int
    is_kept: bool
    dropped: int = 0
    """Images and rows that were left out since the writer is too slow."""

    def __str__(self) -> str:
        """Return the take in words."""
        dropped = f", {self.dropped} images or rows dropped" if self.dropped else ""
        return f"{self.id}: {WORDS[self.success] if self.is_kept else 'discarded'}, {self.rows} rows{dropped}"


def verdict_of(info: Mapping[str, Any]) -> bool | None:
    """Return what the task says of a step; None if it says nothing."""
    success = info.get("success")
    return None if success is None else bool(success)


def instructed(info: Mapping[str, Any], takes: Takes | None, instructions: Sequence[str] = ()) -> Mapping[str, Any]:
    """Return info with the instruction of the take under way, or of the next one, for a policy that begins.

    Args:
        info: Info of a step, or of a reset.
        takes: The takes; None before the first.
        instructions: Instructions of the takes, in turn; none for that of the environment.
    """
    instruction = next(iter(instructions), None) if takes is None else takes.instruction
    return info if instruction is None else {**info, "instruction": instruction}


class Takes:
    """Takes with a recorder, one after the other, with the figures of their loop."""

    def __init__(
        self, recorder: Recorder, frequency: float, *, instructions: Sequence[str] = (), latency: Latency | None = None
    ) -> None:
        """Begin nothing yet.

        Args:
            recorder: Records an environment.
            frequency: Rate of its loop [Hz].
            instructions: Instructions of the takes, in turn; none for that of the environment.
            latency: Measures it; its figures are stored with each take.
        """
        self.ended: list[Take] = []
        """The takes that have ended."""
        self._recorder, self._frequency = recorder, frequency
        self._instructions, self._latency = instructions, latency
        self._statistics = LoopStatistics(frequency)
        self._is_aborted = False

    @property
    def now(self) -> str | None:
        """Id of the take under way; None for none."""
        return self._recorder.take

    @property
    def is_recording(self) -> bool:
        """Whether a take is under way and has a row. One that a failing disk has aborted is over; a reset drops it."""
        return self._recorder.take is not None and self._recorder.is_recording and not self._is_aborted

    @property
    def dropped(self) -> int:
        """Number of images and rows that the take under way has left out; see `Recorder.dropped`."""
        return self._recorder.dropped

    @property
    def kept(self) -> int:
        """Number of takes that were kept."""
        return sum(take.is_kept for take in self.ended)

    @property
    def instruction(self) -> str | None:
        """The instruction of the take under way, or of the next one; None for that of the environment."""
        return self._instructions[self.kept % len(self._instructions)] if self._instructions else None

    def add(self, period: float, info: Mapping[str, Any]) -> None:
        """Count a step of the loop; see `LoopStatistics.add`."""
        if self.now is not None:
            self._statistics.add(period, info)

    def start(self) -> str:
        """Begin a take with the next step, and return what there is to say.

        Raises:
            WrongOrder: A take is under way.
        """
        instruction = self.instruction
        take = self._recorder.start(instruction)
        self._statistics, self._is_aborted = LoopStatistics(self._frequency), False
        if self._latency is not None:
            self._latency.begin_take()
        return f"Take {take} begins{f': {instruction}' if instruction else ''}"

    def finish(self, success: bool | None) -> str:
        """End the take with a verdict, and return what there is to say; it takes longer than a control period.

        Raises:
            WrongOrder: No take is under way, or it has no row yet.
            DatasetError, CorruptEpisode: The disk is full or fails, or has changed what was written; the rows that it
                has stay there for `recover`.
        """
        outcome: dict[str, Any] = {"loop": self._statistics.to_json()}
        if self._latency is not None:
            outcome["latency"] = self._latency.to_json()
        rows, dropped = self._recorder.rows, self._recorder.dropped
        try:
            record = self._recorder.finish(success, outcome)
        except (DatasetError, CorruptEpisode):
            self._is_aborted = True
            raise
        self.ended.append(Take(id=record.id, success=success, rows=rows, is_kept=True, dropped=dropped))
        return f"Take {self.ended[-1]}; {self._statistics}"

    def discard(self) -> str:
        """Drop the take, and return what there is to say.

        Raises:
            WrongOrder: No take is under way.
        """
        take = self.now
        if take is None:
            raise WrongOrder("There is no take to discard.")
        self.ended.append(Take(id=take, success=None, rows=self._recorder.rows, is_kept=False))
        self._recorder.discard()
        return f"Take {take} is discarded."
