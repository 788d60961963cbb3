"""When a policy is asked, and what is executed meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.policy.execution import Execution, Executor
from rcs.policy.plan import ChunkPlan, Part

PERIOD = 1 / 30
PART = Part("joints", slice(0, 1), "linear")


class Course:
    """A loop in simulated time with a policy whose rows are a function of time."""

    def __init__(self, execution: Execution, horizon: int = 12, rate: float = 30.0) -> None:
        self.executor = Executor(execution, PERIOD)
        self.horizon, self.period = horizon, 1 / rate
        self.asked: list[float] = []
        self.error: Exception | None = None
        self.offset: Callable[[float], float] = lambda begin: 0.0
        self.now = 0.0

    def question(self) -> Callable[[], ChunkPlan]:
        now = self.now
        self.asked.append(now)

        def ask() -> ChunkPlan:
            if self.error is not None:
                raise self.error
            ends = now + self.period * (1 + np.arange(self.horizon))
            return ChunkPlan(
                [PART],
                2.0 * ends[:, None] + self.offset(now),
                time=now,
                period=self.period,
                start={"joints": np.array([2.0 * now])},
            )

        return ask

    def run(self, steps: int) -> list[float | None]:
        found: list[float | None] = []
        for _ in range(steps):
            command = self.executor.step(self.now, self.question)
            found.append(None if command is None else float(command["joints"][0]))
            self.now += PERIOD
        return found


@pytest.mark.parametrize("mode", ["open_loop", "receding", "ensemble", "rtc"])
@pytest.mark.parametrize("latency", [0.0, 0.05, 0.1, 0.3])
@pytest.mark.parametrize("rate", [5.0, 20.0, 30.0, 50.0])
def test_whatever_is_executed_is_for_the_moment_at_which_it_is(mode: Any, latency: float, rate: float) -> None:
    course = Course(Execution(mode=mode, latency=latency), horizon=24, rate=rate)
    found = course.run(60)
    executed = [(i, value) for i, value in enumerate(found) if value is not None]
    assert len(executed) > 10
    for i, value in executed:
        # A chunk that ends within a step has its last row at its own end.
        last = max(t + 24 / rate for t in course.asked if t + latency <= i * PERIOD + 1e-9)
        assert value == pytest.approx(2.0 * min((i + 1) * PERIOD, last), abs=1e-9)


def test_nothing_is_executed_before_the_first_answer() -> None:
    found = Course(Execution(latency=0.1)).run(6)
    assert found[:3] == [None] * 3
    assert None not in found[3:]


def test_an_open_loop_executes_its_rows_and_then_holds_until_the_answer() -> None:
    course = Course(Execution(mode="open_loop", latency=0.1, rows=4))
    found = [value is not None for value in course.run(21)]
    assert found == [False] * 3 + ([True] * 4 + [False] * 3) * 2 + [True] * 4


def test_a_receding_horizon_goes_on_while_it_is_asking() -> None:
    course = Course(Execution(mode="receding", latency=0.1, rows=6))
    found = course.run(40)
    assert None not in found[3:]
    np.testing.assert_allclose(np.diff(course.asked), 6 * PERIOD)


def test_an_ensemble_asks_in_every_step_where_answers_are_there_at_once() -> None:
    course = Course(Execution(mode="ensemble"))
    course.run(10)
    np.testing.assert_allclose(course.asked, PERIOD * np.arange(10))


def test_an_action_ends_with_its_time_to_live() -> None:
    course = Course(Execution(mode="receding", rows=12, valid_for=0.2))
    found = [value is not None for value in course.run(12)]
    assert found == [True] * 7 + [False] * 5


def test_a_chunk_that_is_over_is_not_gone_on_with() -> None:
    course = Course(Execution(mode="receding", latency=0.5, rows=1), horizon=18)
    found = [value is not None for value in course.run(33)]
    assert found == [False] * 15 + [True] * 3 + [False] * 12 + [True] * 3


def test_real_time_chunking_changes_over_without_a_jump() -> None:
    steps: dict[str, float] = {}
    for mode in ("receding", "rtc"):
        course = Course(Execution(mode=mode, latency=0.1, rows=9), horizon=24)  # type: ignore[arg-type]
        course.offset = lambda begin: 0.5 * round(begin * 10)
        values = [value for value in course.run(60) if value is not None]
        steps[mode] = float(np.abs(np.diff(values)).max())
    # Chunks are 1.5 apart from one to the next. A blend lasts 0.4 s, and begins while the one before it ends.
    assert steps["receding"] > 1.4
    assert steps["rtc"] < 0.45


def test_an_error_means_hold_at_once_and_another_try_later() -> None:
    course = Course(Execution(rows=6, retry=0.5))
    assert None not in course.run(6)
    course.error = ConnectionError("gone")
    assert set(course.run(15)) == {None}
    assert course.executor.error is course.error
    assert len(course.asked) == 2
    course.error = None
    assert None not in course.run(6)
    assert course.executor.error is None


def test_without_reconnecting_nobody_is_asked_again() -> None:
    course = Course(Execution(rows=6, retry=0.1, on_loss="end"))
    course.error = ConnectionError("gone")
    assert set(course.run(30)) == {None}
    assert len(course.asked) == 1


def threaded(gate: threading.Event, name: str) -> tuple[Executor, Callable[..., Callable[[], ChunkPlan]]]:
    """Return an executor with a thread, and questions that are answered once a gate is open, with their number."""
    executor = Executor(Execution(), PERIOD, name)

    def question() -> Callable[[], ChunkPlan]:
        value = float(next(numbers))

        def compute() -> ChunkPlan:
            assert gate.wait(10.0)
            return ChunkPlan([PART], np.full((30, 1), value), time=0.0, period=PERIOD)

        return compute

    numbers = iter(range(10))
    return executor, question


def first_command(executor: Executor, question: Callable[..., Callable[[], ChunkPlan]]) -> float | None:
    for _ in range(1000):
        if (command := executor.step(0.1, question)) is not None:
            return float(command["joints"][0])
        threading.Event().wait(0.01)
    return None


def test_a_thread_answers_while_the_loop_goes_on() -> None:
    gate = threading.Event()
    executor, question = threaded(gate, "a test")
    assert executor.step(0.0, question) is None
    gate.set()
    assert first_command(executor, question) == 0.0
    assert executor.latency > 0.0
    executor.close()
    assert not any(thread.name == "a test" for thread in threading.enumerate())


def test_the_result_of_a_call_before_the_episode_is_dropped() -> None:
    gate = threading.Event()
    executor, question = threaded(gate, "another test")
    assert executor.step(0.0, question) is None
    executor.reset()
    assert executor.step(0.0, question) is None
    gate.set()
    assert first_command(executor, question) == 1.0
    executor.close()


@pytest.mark.parametrize(
    "wrong", [{"mode": "fast"}, {"rows": 0}, {"latency": -0.1}, {"valid_for": float("nan")}, {"on_loss": "ignore"}]
)
def test_options_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup, match=next(iter(wrong))):
        Execution(**wrong)


@pytest.mark.parametrize("mode", ["ensemble", "rtc"])
def test_no_chunk_is_mixed_in_beyond_its_time_to_live(mode: Any) -> None:
    course = Course(Execution(mode=mode, rows=6, valid_for=0.3), horizon=24)
    course.offset = lambda begin: 100.0 if begin == 0.0 else 0.0
    values = course.run(24)
    apart = [-1.0 if value is None else value - 2.0 * (i + 1) * PERIOD for i, value in enumerate(values)]
    assert min(apart[:9]) > 1.0, "the first chunk is executed"
    np.testing.assert_allclose(apart[10:], 0.0, atol=1e-9)
