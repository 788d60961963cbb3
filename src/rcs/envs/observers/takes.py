"""Takes of a person who records demonstrations: start, stop, judge, discard, repeat."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs_data import Dataset, DatasetWriter, EpisodeRecord

from rcs.envs.observers.recorder import Recorder
from rcs.errors import WrongOrder


class Takes:
    """Numbers the episodes of a recorder and keeps, drops or repeats them one at a time.

    A take begins with the first observation after `start`, of a reset or of a step in a running loop. A discarded take
    leaves nothing in memory or on disk.
    """

    def __init__(self, recorder: Recorder, writer: DatasetWriter) -> None:
        """Continue after the last episode of the dataset.

        Args:
            recorder: The recorder, an observer of the environment.
            writer: The dataset that it records into.
        """
        self._recorder = recorder
        self._writer = writer
        numbers = [int(e.id) for e in Dataset.open(writer.path).episodes if e.id.isdigit()]
        self._next = max(numbers, default=-1) + 1
        self._id: str | None = None
        self._instruction: str | None = None
        self._last: tuple[str, str | None] | None = None

    @property
    def current(self) -> str | None:
        """The id of the take under way; None between takes."""
        return self._id

    def start(self, instruction: str | None = None, *, at_reset: bool = False) -> str:
        """Begin a take and return its id.

        Args:
            instruction: Instruction for the robot; None for the dataset's instruction.
            at_reset: Whether to wait for the next reset, instead of beginning with the next step.

        Raises:
            WrongOrder: A take is under way.
        """
        if self._id is not None:
            raise WrongOrder(f"Take {self._id!r} is under way; stop or discard it before the next.")
        self._begin(f"{self._next:06d}", instruction, at_reset)
        self._next += 1
        assert self._id is not None
        return self._id

    def stop(self, success: bool | None, outcome: Mapping[str, Any] | None = None) -> EpisodeRecord:
        """End the take and keep it.

        Args:
            success: Whether the task was done; None for no verdict.
            outcome: Other facts about the take, as JSON values.

        Raises:
            WrongOrder: No take is under way, or it has no observation yet.
        """
        take = self._require_take("stop")
        if not self._recorder.is_recording:
            raise WrongOrder(f"Take {take!r} has no observation yet; step or reset the environment, or discard it.")
        record = self._recorder.finish(success, outcome)
        self._last, self._id = (take, self._instruction), None
        return record

    def discard(self) -> None:
        """End the take and drop it; its number is given to the next.

        Raises:
            WrongOrder: No take is under way.
        """
        take = self._require_take("discard")
        self._recorder.discard()
        self._recorder.forget_next()
        self._id = None
        if take == f"{self._next - 1:06d}":
            self._next -= 1

    def retake(self, *, at_reset: bool = False) -> str:
        """Repeat the take under way, or else the last one kept, under the same id and instruction.

        Args:
            at_reset: As in `start`.

        Raises:
            WrongOrder: There was no take yet.
        """
        if self._id is not None:
            self._recorder.discard()
            again = (self._id, self._instruction)
        elif self._last is not None:
            self._writer.remove_episode(self._last[0])
            again, self._last = self._last, None
        else:
            raise WrongOrder("There is no take to repeat; start one first.")
        self._begin(*again, at_reset)
        return again[0]

    def _begin(self, take: str, instruction: str | None, at_reset: bool) -> None:
        self._recorder.name_next(take, instruction=instruction, at_reset=at_reset)
        self._id, self._instruction = take, instruction

    def _require_take(self, doing: str) -> str:
        if self._id is None:
            raise WrongOrder(f"There is no take to {doing}; start one first.")
        return self._id
