"""Execution of chunks: when the policy is called, and what is commanded at every step."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Literal

from rcs_data.options import NotNegative, Record, Whole

from rcs.background_thread import BackgroundThread
from rcs.policy.plan import ChunkPlan, Command, averaged, blended

Mode = Literal["open_loop", "receding", "ensemble", "rtc"]
"""`open_loop`: execute some rows, hold, call the policy. `receding`: call it while the rest of the chunk is executed,
and change over when the answer is there. `ensemble`: call it all the time, and execute the mean of all chunks for the
moment (ACT). `rtc`: as `receding`, but blend over from the chunk in flight (as in real-time chunking)."""

NEAR = 1e-9
"""Time that is rounding [s]."""

_log = logging.getLogger(__name__)


class Execution(Record):
    """Options of the execution of chunks.

    In all modes actions are picked by time: a late answer skips rows and never lags.
    """

    mode: Mode = "receding"
    """How chunks are executed: `open_loop` executes rows, then holds until the next answer; `receding` calls the policy
    while the rest is executed; `ensemble` takes the mean of all chunks; `rtc` blends over from the chunk in flight."""
    rows: Whole | None = None
    """Rows of a chunk that pass, by time, before the policy is called again. None for all of them in `open_loop`, and
    half of them otherwise; `ensemble` calls it as often as it answers."""
    latency: NotNegative = 0.0
    """Delay of an answer in simulated time [s], which stands still while the policy computes. In real time,
    answers take as long as they take."""
    valid_for: NotNegative | None = None
    """Time to live of an action: how old the observation that it answers may be [s]. Later, the robot holds, and no
    other chunk is mixed with it. None for as long as the chunk has rows."""
    decay: NotNegative = 0.01
    """ACT's m: the weight of the i-th oldest chunk is exp(-m·i). 0 weighs all alike; more trusts the older ones."""
    on_loss: Literal["reconnect", "end"] = "reconnect"
    """After an error of the policy or its connection, the robot holds; then, connect again and continue, or end the
    episode."""
    retry: NotNegative = 1.0
    """Pause between an error and the next call of the policy [s], while the robot holds."""


Question = Callable[[], Callable[[], ChunkPlan]]
"""Makes a call of the present observation."""

Call = Future[tuple[ChunkPlan, float]]
"""A call of the policy: its chunk, and how long it took by the wall clock [s]."""


class Executor:
    """Calls the policy and executes its chunks by time; it knows neither policy nor robot, and reads no clock."""

    def __init__(self, execution: Execution, period: float, thread: str | None = None) -> None:
        """Prepare.

        Args:
            execution: The options.
            period: Duration of a step of the loop [s].
            thread: Name of the thread that calls the policy, so that a loop in real time never waits; None for
                simulated time, where the loop waits and the result counts after `execution.latency`.
        """
        self._execution, self._period = execution, period
        self._valid_for = math.inf if execution.valid_for is None else execution.valid_for
        self._thread = None if thread is None else BackgroundThread[Callable[[], None]](thread, lambda run: run())
        self.error: Exception | None = None
        """The error because of which the robot holds."""
        self.chunks = 0
        """Chunks of this episode."""
        self.reset()

    def reset(self) -> None:
        """Begin an episode; the result of a call that is under way is dropped."""
        self._call: tuple[Call, float] | None = None  # and when it began, in the time of the loop [s]
        self._plans: list[ChunkPlan] = []  # from the oldest to the newest
        self._due = 0.0
        self.latency = float("nan")
        """Delay of the newest answer, in the time of the loop [s]."""
        self.seconds = float("nan")
        """Time that the newest answer took by the wall clock [s], also where simulated time stood still."""
        self._retry_at = 0.0
        self.error, self.chunks = None, 0

    def fail(self, error: Exception, now: float) -> None:
        """Have the robot hold because of an error, at a time [s]."""
        _log.error("The robot holds, because its policy failed: %s: %s", type(error).__name__, error)
        self.error = error
        self._call, self._plans = None, []
        self._retry_at = now + self._execution.retry

    def step(self, now: float, question: Question) -> Command | None:
        """Return what to command for the step that begins now; None to hold.

        Args:
            now: The time [s].
            question: Makes a call of the present observation.
        """
        self._take(now)
        if self._call is None and self._is_due(now):
            self._start(now, question)
            self._take(now)  # in simulated time the result may be there at once
        if not self._plans or now - self._plans[-1].begin > self._valid_for + NEAR:
            return None
        if self._execution.mode == "open_loop" and now >= self._due - NEAR:
            return None
        if self._execution.mode == "ensemble":
            decay = self._execution.decay
            return averaged(self._plans, now, self._period, decay=decay, valid_for=self._valid_for)
        return blended(self._plans, now, self._period)

    def age(self, now: float) -> float:
        """Return how old the observation is that the newest chunk answers [s]."""
        return now - self._plans[-1].begin if self._plans else float("nan")

    def row(self, now: float) -> float:
        """Return which row of the newest chunk a step belongs to that begins at a time."""
        return float(self._plans[-1].row(now + self._period / 2)) if self._plans else float("nan")

    def close(self) -> None:
        """End the thread; one that waits for a silent policy is left behind after a second."""
        if self._thread is not None:
            self._thread.close(timeout=1.0)

    def _is_due(self, now: float) -> bool:
        if self.error is not None:
            return self._execution.on_loss == "reconnect" and now >= self._retry_at - NEAR
        return not self._plans or self._execution.mode == "ensemble" or now >= self._due - NEAR

    def _start(self, now: float, question: Question) -> None:
        """Call the policy, or have the thread call it."""
        call, compute, begin = Call(), question(), time.perf_counter()

        def run() -> None:
            try:
                call.set_result((compute(), time.perf_counter() - begin))
            except Exception as err:  # noqa: BLE001  whatever it is, the robot holds and the log says why
                call.set_exception(err)

        self._call = call, now
        if self._thread is None:
            run()
        else:
            self._thread.put(run)

    def _take(self, now: float) -> None:
        """Take the result of the call, once it is there."""
        if self._call is None:
            return
        (call, begin), latency = self._call, self._execution.latency
        if not call.done() or (self._thread is None and now < begin + latency - NEAR):
            return
        self._call = None
        if (error := call.exception()) is not None:
            assert isinstance(error, Exception), "others are not caught"
            self.fail(error, now)
            return
        if self.error is not None:
            _log.warning("The policy answers again after: %s", self.error)
            self.error = None
        plan, self.seconds = call.result()
        self.latency = latency if self._thread is None else self.seconds
        self._change_over(plan, now)

    def _change_over(self, new: ChunkPlan, now: float) -> None:
        """Execute a new chunk from now on."""
        mode, self.chunks = self._execution.mode, self.chunks + 1
        horizon = round((new.end - new.begin) / new.period)
        rows = self._execution.rows or (horizon if mode == "open_loop" else max(1, horizon // 2))
        # An open loop counts the rows that it executes; the other modes call the policy at a rate.
        self._due = min((now if mode == "open_loop" else new.begin) + rows * new.period, new.end)
        former: list[ChunkPlan] = []
        if mode == "ensemble":
            former = [plan for plan in self._plans if plan.end > now and now - plan.begin <= self._valid_for]
        elif mode == "rtc" and self._plans:
            until = min(self._plans[-1].end, self._plans[-1].begin + self._valid_for)
            if until > now + NEAR:
                new.since, new.until = now, until
                alone = max(i for i, plan in enumerate(self._plans) if i == 0 or plan.weight_before(now) == 0)
                former = self._plans[alone:]
        self._plans = [*former, new]
