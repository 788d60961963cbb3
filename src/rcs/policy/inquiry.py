"""One question to a policy at a time: answered in simulated time, or by a thread in real time."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcs.worker import Worker

NEAR = 1e-9
"""Time that is rounding [s]."""


@dataclass(frozen=True)
class Answer:
    """What came of a question."""

    chunk: Any
    """A `vlagents.Chunk`; None after an error."""
    error: Exception | None
    latency: float
    """Time from the question until the answer was known [s], in the time of the loop."""
    seconds: float
    """What it took by the wall clock [s]."""


class Inquiry(ABC):
    """Asks one question at a time."""

    is_pending: bool
    """Whether a question has no answer yet."""

    @abstractmethod
    def ask(self, question: Callable[[], Any], now: float) -> None:
        """Ask, at a time [s]; only while no question is pending."""

    @abstractmethod
    def answer(self, now: float) -> Answer | None:
        """Return the answer if it is known at a time [s], once."""

    @abstractmethod
    def drop(self) -> None:
        """Forget a question that is pending: its answer comes to nobody."""

    def close(self) -> None:  # noqa: B027  one without a thread has nothing to end
        """End the thread."""


class SimulatedInquiry(Inquiry):
    """Waits for the policy while simulated time stands still; the answer counts as known `latency` later.

    What follows depends on no clock but that of the simulation.
    """

    def __init__(self, latency: float = 0.0) -> None:
        """Set the latency [s of simulated time]."""
        self._latency = latency
        self._answer: tuple[float, Answer] | None = None

    @property
    def is_pending(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether a question has no answer yet."""
        return self._answer is not None

    def ask(self, question: Callable[[], Any], now: float) -> None:
        """Ask, and keep the answer until its time."""
        self._answer = (now + self._latency, _asked(question, self._latency))

    def answer(self, now: float) -> Answer | None:
        """Return the answer once its time has come."""
        if self._answer is None or now < self._answer[0] - NEAR:
            return None
        _, answer = self._answer
        self._answer = None
        return answer

    def drop(self) -> None:
        """Forget the answer."""
        self._answer = None


class ThreadedInquiry(Inquiry):
    """Asks in a thread, so that the loop of a robot never waits."""

    def __init__(self, name: str) -> None:
        """Prepare; the thread starts with the first question.

        Args:
            name: Of the thread.
        """
        self._worker: Worker[tuple[int, Callable[[], Any]]] = Worker(name, self._ask)
        self._answer: tuple[int, Answer] | None = None
        self._number = 0
        self.is_pending = False

    def ask(self, question: Callable[[], Any], now: float) -> None:
        """Hand a question to the thread."""
        self._number += 1
        self.is_pending = True
        self._worker.put((self._number, question))

    def answer(self, now: float) -> Answer | None:
        """Return the answer if the thread has it."""
        if not self.is_pending or self._answer is None or self._answer[0] != self._number:
            return None
        self.is_pending = False
        return self._answer[1]

    def drop(self) -> None:
        """Drop the question; its answer is discarded."""
        self.is_pending = False

    def close(self) -> None:
        """End the thread; one that waits for a silent policy is left behind after a second."""
        self._worker.close(timeout=1.0)

    def _ask(self, asked: tuple[int, Callable[[], Any]]) -> None:
        number, question = asked
        self._answer = number, _asked(question, None)


def _asked(question: Callable[[], Any], latency: float | None) -> Answer:
    begin = time.perf_counter()
    try:
        chunk, error = question(), None
    except Exception as err:  # noqa: BLE001  whatever a policy or a wire raises, the robot holds and the log says why
        chunk, error = None, err
    seconds = time.perf_counter() - begin
    return Answer(chunk, error, seconds if latency is None else latency, seconds)
