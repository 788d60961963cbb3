from __future__ import annotations

from copy import deepcopy

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots.cameras import USB_WEBCAM
from rcs.sim import World
from rcs.sim.camera_feed import FrameClock, FrameRate
from rcs.sim.world import Stepping

MODEL = mujoco.MjModel.from_xml_string("<mujoco><option timestep='0.002'/></mujoco>")
WEBCAM = FrameRate(fps=30, longest_exposure=0.04)


def steady(
    fps: float, frequency: float, *, mode: Stepping = "async", copies: int | None = None
) -> tuple[World, FrameClock]:
    world = World(MODEL, frequency=frequency, stepping=mode, copies=copies)
    world.reset()
    return world, FrameClock(world, {"eye": FrameRate(fps=fps)})


def flags(world: World, clock: FrameClock, steps: int, name: str = "eye") -> NDArray[np.bool_]:
    """Return whether there is a new frame at the start and after each step, (steps + 1, copies)."""
    taken = [clock.take()[name]]
    for _ in range(steps):
        world.advance()
        taken.append(clock.take()[name])
    return np.array(taken)


@settings(max_examples=30, deadline=None)
@given(fps=st.integers(1, 120), frequency=st.integers(20, 250))
def test_a_frame_is_there_at_the_first_step_after_it_is_due(fps: int, frequency: int) -> None:
    is_new = flags(*steady(fps, frequency), steps=2 * frequency)[:, 0]
    due = -(-np.arange(2 * fps + 1) * frequency // fps)  # ceil(n * frequency / fps)
    np.testing.assert_array_equal(np.flatnonzero(is_new), np.unique(due))


def test_a_camera_that_is_no_slower_than_control_has_a_frame_at_each_step() -> None:
    for fps in (30, 60, 90):
        world, clock = steady(fps, 30.0)
        assert clock.has_frame_each_step("eye")
        assert flags(world, clock, 60).all()
    assert not steady(30, 30.5)[1].has_frame_each_step("eye")


def test_thirty_frames_beside_a_hundred_steps_do_not_drift_in_a_day() -> None:
    world, clock = steady(30, 100.0)
    world.core.steps[:] = 24 * 3600 * 100
    clock.take()
    assert clock.numbers["eye"][0] == 24 * 3600 * 30
    world.core.steps[:] += 3
    assert not clock.take()["eye"][0]
    world.core.steps[:] += 1
    assert clock.take()["eye"][0]


def test_asking_again_at_the_same_time_gives_nothing_new() -> None:
    world, clock = steady(30, 30.0)
    world.advance()
    assert clock.take()["eye"].all()
    assert not clock.take()["eye"].any()


def test_a_copy_that_starts_anew_has_a_frame_and_counts_from_there() -> None:
    world, clock = steady(10, 50.0, copies=3)
    assert flags(world, clock, 3).sum() == 3
    one = np.array([1], np.int32)
    world.reset(one)
    np.testing.assert_array_equal(clock.take()["eye"], [False, True, False])
    is_new = flags(world, clock, 5)[1:]
    np.testing.assert_array_equal(np.flatnonzero(is_new[:, 1]), [4])
    np.testing.assert_array_equal(np.flatnonzero(is_new[:, 0]), [1])
    np.testing.assert_array_equal(is_new[:, 0], is_new[:, 2])


def test_synchronous_steps_count_by_the_time_that_they_took() -> None:
    world, clock = steady(30, 30.0, mode="sync")
    world.core.set_state(world.core.get_state(0))
    world.time[...] = 5.0  # an episode may start in a state of another
    clock.take()
    lengths = [0.010, 0.010, 0.012, 0.004, 0.030, 0.500]
    expected = [False, False, False, True, False, True]
    for i, (length, is_new) in enumerate(zip(lengths, expected, strict=True)):
        world.time[...] += length
        world.core.steps[:] = i + 1
        assert clock.take()["eye"][0] == is_new, i
    assert clock.numbers["eye"][0] == int(0.566 * 30)
    assert not clock.has_frame_each_step("eye")


def rolling(key: int | list[int], steps: int = 2000, name: str = "eye") -> NDArray[np.bool_]:
    copies = len(key) if isinstance(key, list) else None
    world = World(MODEL, frequency=500.0, copies=copies)
    world.reset()
    clock = FrameClock(world, {name: WEBCAM, "other": WEBCAM})
    clock.begin(np.array(key, np.uint64))
    return flags(world, clock, steps, name)


def test_the_frames_of_a_webcam_come_33_to_40_ms_apart_and_each_at_its_own() -> None:
    gaps = np.diff(np.flatnonzero(rolling(7)[:, 0])) * 0.002
    # A frame shows at the first physics step after it is due.
    assert gaps.min() >= 1 / 30 - 0.002
    assert gaps.max() <= 0.040 + 0.002
    assert gaps.mean() == pytest.approx((1 / 30 + 0.040) / 2, abs=0.0005)
    assert len(np.unique(gaps.round(3))) >= 4


def test_the_intervals_of_a_webcam_follow_from_key_and_name_in_any_copy() -> None:
    both = rolling([3, 2**64 - 1], 300)
    for copy, key in enumerate((3, 2**64 - 1)):
        np.testing.assert_array_equal(both[:, copy], rolling(key, 300)[:, 0])
    assert not np.array_equal(both[:, 0], both[:, 1])
    assert not np.array_equal(both[:, 0], rolling(3, 300, "another")[:, 0])


def test_a_clock_goes_on_as_the_one_whose_memory_it_gets() -> None:
    worlds, clocks = [World(MODEL, frequency=500.0) for _ in range(2)], []
    for world, key in zip(worlds, (3, 9), strict=True):
        world.reset()
        clock = FrameClock(world, {"eye": WEBCAM})
        clock.begin(np.array([key], np.uint64))
        flags(world, clock, 50)
        clocks.append(clock)
    one, other = clocks
    for name in FrameClock.memory:
        setattr(other, name, deepcopy(getattr(one, name)))
    np.testing.assert_array_equal(flags(worlds[1], other, 300), flags(worlds[0], one, 300))


def test_a_webcam_that_is_slow_enough_for_its_exposure_keeps_its_rate() -> None:
    rate = FrameRate(fps=15, longest_exposure=USB_WEBCAM.longest_exposure)
    world = World(MODEL, frequency=60.0)
    clock = FrameClock(world, {"eye": rate})
    assert not rate.is_rolling
    np.testing.assert_array_equal(np.flatnonzero(flags(world, clock, 20)[:, 0]), [0, 4, 8, 12, 16, 20])


def test_a_webcam_has_a_frame_at_each_step_that_is_longer_than_its_exposure() -> None:
    world = World(MODEL, frequency=20.0)
    clock = FrameClock(world, {"eye": WEBCAM})
    assert clock.has_frame_each_step("eye")
    assert flags(world, clock, 50).all()
    assert not FrameClock(World(MODEL, frequency=30.0), {"eye": WEBCAM}).has_frame_each_step("eye")


@pytest.mark.parametrize("fps", [0, -30, float("nan"), float("inf")])
def test_a_rate_is_positive(fps: float) -> None:
    with pytest.raises(InvalidSetup, match="fps"):
        FrameRate(fps=fps)
