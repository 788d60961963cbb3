"""Times of a device are mapped to the host's: within a millisecond over drift, late packets and jumps."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import DeviceFault
from rcs.hardware.device_clock import DeviceClock

FASTEST = 4e-3


def errors(
    drift: float, seconds: float, *, late: tuple[float, float] = (0.0, 0.0), by: float = 0.1, swing: float = 0.0
) -> np.ndarray:
    """Return the errors of mapped times [s] at 30 frames/s, where packets of a span are late by a constant, too."""
    rng = np.random.default_rng(1)
    taken = np.arange(0.0, seconds, 1 / 30)
    device = 7e4 + taken * (1 - drift) - swing * np.sin(2 * np.pi * taken / 3600) * 3600 / (2 * np.pi)
    delays = FASTEST + rng.gamma(2.0, 1.5e-3, len(taken))
    delays[(taken >= late[0]) & (taken < late[1])] += by
    arrived = np.maximum.accumulate(1e3 + taken + delays)
    clock = DeviceClock(latency=FASTEST)
    mapped = np.array([clock.host_time(d, a) for d, a in zip(device.tolist(), arrived.tolist(), strict=True)])
    assert (np.diff(mapped) > 0).all(), "time goes on"
    assert (mapped <= arrived).all(), "no frame is from the future"
    return mapped - 1e3 - taken


@pytest.mark.parametrize(("drift", "seconds"), [(1e-4, 1800.0), (-1e-4, 300.0), (0.0, 300.0)])
def test_drift_over_half_an_hour_is_followed_within_a_millisecond(drift: float, seconds: float) -> None:
    off = np.abs(errors(drift, seconds))
    assert off[30:].max() < 1e-3, "after the first second"
    assert off.max() < 10e-3


def test_drift_that_changes_with_the_temperature_is_followed_too() -> None:
    assert np.abs(errors(2e-5, 900.0, swing=1e-5))[30:].max() < 1e-3


@pytest.mark.parametrize("span", [(20.0, 21.0), (60.0, 180.0)])
def test_late_packets_keep_the_times_of_their_pictures(span: tuple[float, float]) -> None:
    assert np.abs(errors(5e-5, 240.0, late=span))[30:].max() < 2e-3


def test_a_session_that_begins_late_is_right_as_soon_as_packets_come_in_time() -> None:
    off = errors(5e-5, 60.0, late=(0.0, 5.0))
    assert np.abs(off[30 * 8 :]).max() < 2e-3


@pytest.mark.parametrize("begin", [0.0, 1e6])
def test_a_clock_may_have_begun_long_before_or_after_the_hosts(begin: float) -> None:
    clock = DeviceClock()
    clock.host_time(begin + 1.0, 500.0)
    assert clock.host_time(begin + 1.5, 500.5) == pytest.approx(500.5, abs=1e-3)
    with pytest.raises(DeviceFault, match="back"):
        clock.host_time(begin + 1.4, 500.6)


def test_a_clock_that_jumps_is_a_fault_and_never_a_false_time() -> None:
    for jump, words in ((-5.0, "back"), (5.0, "jumped ahead")):
        clock = DeviceClock()
        for i in range(150):
            clock.host_time(10.0 + i / 30, 500.0 + i / 30 + 0.003)
        with pytest.raises(DeviceFault, match=words):
            clock.host_time(10.0 + 150 / 30 + jump, 500.0 + 150 / 30 + 0.003)


def test_a_second_of_pictures_that_were_half_a_second_late_is_no_jump() -> None:
    clock = DeviceClock()
    for i in range(60):
        late = 0.5 * (i < 30)
        mapped = clock.host_time(10.0 + i / 30, max(500.0 + i / 30 + 0.003 + late, 501.47 * (i >= 30)))
    assert mapped == pytest.approx(500.0 + 59 / 30 + 0.003, abs=0.05)


def test_the_same_moment_has_the_same_time_and_the_fit_is_known() -> None:
    clock = DeviceClock()
    times = [clock.host_time(10.0 + i * (1 - 1e-4), 500.0 + i) for i in range(60)]
    assert clock.host_time(10.0 + 59 * (1 - 1e-4), 560.0) == times[-1]
    assert clock.drift == pytest.approx(1e-4, abs=1e-6)
    assert clock.offset == pytest.approx(490.0 + 59e-4, abs=1e-4)
