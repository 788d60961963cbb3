"""Executes chunks: decides when the policy is asked, and what is commanded at every step."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcs.policy.execution import Execution
from rcs.policy.inquiry import NEAR, Answer, Inquiry
from rcs.policy.plan import Blend, ChunkPlan, Command, Ensemble, Plan

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Flight:
    """What is in flight when the policy is asked, for one that goes on from it."""

    plan: Plan
    delay: float
    """How long the plan is expected to be executed still, until the answer is known [s]."""


Question = Callable[[Flight | None], Callable[[], ChunkPlan]]
"""Makes a question of the present observation."""


class Executor:
    """Asks and executes by time. It knows neither the policy nor the robot, and reads no clock."""

    def __init__(self, execution: Execution, inquiry: Inquiry, period: float) -> None:
        """Prepare.

        Args:
            execution: How.
            inquiry: Asks.
            period: How long a step of the loop is [s].
        """
        self._execution, self._inquiry, self._period = execution, inquiry, period
        self._plan: Plan | None = None
        self._newest: ChunkPlan | None = None
        self._due = 0.0
        self._latencies: list[float] = []
        self._retry_at: float | None = None
        self.error: Exception | None = None
        """Why the robot holds, if the policy or its connection failed."""
        self.chunks = 0
        """How many chunks came in this episode."""
        self.seconds: list[float] = []
        """What each answer took by the wall clock [s]."""

    def reset(self) -> None:
        """Begin an episode with nothing in flight."""
        self._inquiry.drop()
        self._plan = self._newest = None
        self._due = 0.0
        self._latencies, self._retry_at, self.error = [], None, None
        self.chunks, self.seconds = 0, []

    @property
    def latency(self) -> float:
        """How long the newest answer was on its way [s]."""
        return self._latencies[-1] if self._latencies else float("nan")

    def fail(self, error: Exception, now: float) -> None:
        """Have the robot hold because of an error, at a time [s]."""
        _log.error("The robot holds, because its policy failed: %s: %s", type(error).__name__, error)
        self.error = error
        self._plan = self._newest = None
        self._inquiry.drop()
        self._retry_at = now + self._execution.retry

    def step(self, now: float, question: Question) -> Command | None:
        """Return what to command for the step that begins now; None to hold.

        Args:
            now: When [s].
            question: Makes a question of the present observation.
        """
        self._take(now)
        if not self._inquiry.is_pending and self._wants_to_ask(now):
            self._ask(now, question)
            self._take(now)  # in simulated time an answer may be there at once
        if self._plan is None:
            return None
        self._plan = self._plan.simplified(now)
        if self._execution.mode == "open_loop" and now >= self._due - NEAR:
            return None
        limit = self._execution.valid_for
        if limit is not None and now - self._plan.begin > limit + NEAR:
            return None
        return self._plan.at(now, self._period)

    def age(self, now: float) -> float:
        """Return how old the observation is that the newest chunk answers [s]."""
        return float("nan") if self._newest is None else now - self._newest.begin

    def row(self, now: float) -> float:
        """Return which row of the newest chunk a step belongs to that begins at a time."""
        return float("nan") if self._newest is None else float(self._newest.row(now + self._period / 2))

    def close(self) -> None:
        """End the thread that asks, if there is one."""
        self._inquiry.close()

    def _wants_to_ask(self, now: float) -> bool:
        if self.error is not None:
            return (
                self._execution.on_loss == "reconnect" and self._retry_at is not None and now >= self._retry_at - NEAR
            )
        if self._newest is None or self._execution.mode == "ensemble":
            return True
        return now >= self._due - NEAR

    def _ask(self, now: float, question: Question) -> None:
        flight = None
        if self._execution.mode == "rtc" and self._plan is not None:
            # As in real-time chunking, the longest of the last delays is what is counted on.
            flight = Flight(self._plan, max(self._latencies[-10:], default=0.0))
        self._inquiry.ask(question(flight), now)

    def _take(self, now: float) -> None:
        answer = self._inquiry.answer(now)
        if answer is None:
            return
        self.seconds.append(answer.seconds)
        if answer.error is not None:
            self.fail(answer.error, now)
            return
        if self.error is not None:
            _log.warning("The policy answers again after: %s", self.error)
            self.error = None
        self._begin(answer, now)

    def _begin(self, answer: Answer, now: float) -> None:
        """Have a chunk take over."""
        new: Any = answer.chunk
        assert isinstance(new, ChunkPlan), "a question returns a plan"
        self._latencies.append(answer.latency)
        self.chunks += 1
        old, self._newest = self._plan, new
        horizon = round((new.end - new.begin) / new.period)
        rows = self._execution.rows or (horizon if self._execution.mode == "open_loop" else max(1, horizon // 2))
        # An open loop counts what it executes; the others ask at a rate.
        since = now if self._execution.mode == "open_loop" else new.begin
        self._due = min(since + rows * new.period, new.end)
        if self._execution.mode == "ensemble":
            self._plan = old.joined(new, now) if isinstance(old, Ensemble) else Ensemble([new], self._execution.decay)
        elif self._execution.mode == "rtc" and old is not None and old.end > now + NEAR and not new.continues:
            self._plan = Blend(old, new, now, old.end)
        else:
            self._plan = new
