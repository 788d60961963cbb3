from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs._core import StepEnd
from rcs.envs.ports.port import Port
from rcs.envs.step import clock as clock_module
from rcs.envs.step.clock import Clock
from rcs.errors import InvalidSetup


class Lift(Port):
    """A device that needs a while."""

    action_spaces = {}
    observation_spaces = {}

    def __init__(self, now, arrival: float) -> None:
        self._now, self._arrival = now, arrival

    def command(self, action) -> None:
        return

    def observe(self):
        return {}

    def has_arrived(self) -> bool:
        return self._now() >= self._arrival


def test_a_loop_keeps_its_rate_exactly_in_the_mean(clock) -> None:
    wall = Clock(frequency=30.0, now=clock, sleep=clock.sleep)
    wall.reset()
    for _ in range(300):
        clock.now += 0.013  # what the step itself takes
        wall.advance()
        assert wall.ends[0] == StepEnd.period.value
    assert clock.now == pytest.approx(110.0, abs=1e-9)


def test_a_late_step_is_not_caught_up(clock) -> None:
    wall = Clock(frequency=10.0, now=clock, sleep=clock.sleep)
    wall.reset()
    clock.now += 0.75
    wall.advance()
    assert clock.slept == []
    wall.advance()
    wall.advance()
    np.testing.assert_allclose(clock.slept, [0.1, 0.1], atol=1e-9)


def test_time_before_reset_does_not_count(clock) -> None:
    wall = Clock(frequency=10.0, now=clock, sleep=clock.sleep)
    clock.now += 5.0
    wall.reset()
    wall.advance()
    np.testing.assert_allclose(clock.slept, [0.1], atol=1e-9)


def test_a_synchronous_step_waits_for_the_slowest_device(clock) -> None:
    ports = [Lift(clock, 100.2), Lift(clock, 100.5)]
    wall = Clock(ports=ports, is_synchronous=True, now=clock, sleep=clock.sleep)
    wall.advance()
    assert wall.ends[0] == StepEnd.converged.value
    assert clock.now == pytest.approx(100.5, abs=2e-3)


def test_a_synchronous_step_ends_at_its_time_limit(clock) -> None:
    wall = Clock(ports=[Lift(clock, 1e9)], is_synchronous=True, time_limit=0.5, now=clock, sleep=clock.sleep)
    wall.advance()
    assert wall.ends[0] == StepEnd.limit.value
    assert clock.now == pytest.approx(100.5, abs=2e-3)


def test_a_synchronous_step_tells_the_targets_again_once_per_period(clock) -> None:
    wall = Clock(ports=[Lift(clock, 100.95)], frequency=10.0, is_synchronous=True, now=clock, sleep=clock.sleep)
    moments: list[float] = []
    wall.advance(None, lambda: moments.append(clock.now))
    np.testing.assert_allclose(moments, 100.1 + 0.1 * np.arange(9), atol=2e-3)


def test_a_tick_lasts_a_period_though_steps_wait_for_devices(clock) -> None:
    wall = Clock(ports=[Lift(clock, 1e9)], frequency=10.0, is_synchronous=True, now=clock, sleep=clock.sleep)
    wall.tick()
    assert clock.now == pytest.approx(100.1, abs=1e-9)


@pytest.mark.parametrize(
    "numbers", [{"frequency": 0.0}, {"frequency": -1.0}, {"frequency": float("nan")}, {"time_limit": 0.0}]
)
def test_numbers_that_are_not_positive_are_refused(numbers: dict[str, float]) -> None:
    with pytest.raises(InvalidSetup, match="must be positive"):
        Clock(**numbers)


def test_a_simulation_in_real_time_waits_for_the_wall_clock(clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_module.time, "perf_counter", clock)
    monkeypatch.setattr(clock_module.time, "sleep", clock.sleep)
    env = rcs.make("Free", stepping="realtime", frequency=50.0)
    env.reset(seed=0)
    start = clock.now
    for _ in range(10):
        clock.now += 0.004
        env.step(env.action_space.sample())
    assert clock.now - start == pytest.approx(0.2, abs=1e-9)
    clock.now += 1.0
    slept = len(clock.slept)
    env.step(env.action_space.sample())
    assert len(clock.slept) == slept
    env.step(env.action_space.sample())
    assert clock.slept[-1] == pytest.approx(0.02, abs=1e-9)


def test_a_simulation_that_is_not_in_real_time_never_waits(clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_module.time, "sleep", clock.sleep)
    env = rcs.make("Free")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert clock.slept == []


def test_a_simulation_in_real_time_leads_its_arm_as_one_that_does_not_wait(
    clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock_module.time, "perf_counter", clock)
    monkeypatch.setattr(clock_module.time, "sleep", clock.sleep)
    led = {}
    for stepping in ("async", "realtime"):
        with rcs.make("Free", stepping=stepping, max_episode_steps=None) as env:
            env.reset(seed=0)
            env.action_space.seed(0)
            world = env.simulation.world
            rows: list[Any] = []
            world.on_period(lambda view, rows=rows: rows.append(view.ctrl.copy()), world.model.opt.timestep)
            for k in range(40):
                clock.now += 0.05 * (k % 7 == 0)  # some steps come late
                env.step(env.action_space.sample())
            led[stepping] = np.array(rows)
    np.testing.assert_array_equal(led["realtime"], led["async"])
