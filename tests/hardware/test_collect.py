"""Collecting with a vendor's library on a virtual robot: its world places the objects and judges; then the replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset, check

import rcs
from rcs.errors import DeviceFault
from rcs.hardware import DeviceAddress
from rcs.rollout import Collection, Progress, collect
from rcs.rollout.reexecute import reexecute
from rcs.virtual import VirtualProcess

pytestmark = pytest.mark.hardware
pytest.importorskip("scservo_sdk", reason="the driver of SO101 arms needs feetech-servo-sdk")


PATIENT = 0.6
"""Time in which servos must answer: the machine may be busy [s]."""


def collection(virtual: VirtualProcess, out: Path, episodes: int) -> Collection:
    given = virtual.site.arms["so101"]
    assert isinstance(given, DeviceAddress)
    place = replace(given, options={**given.options, "timeout": PATIENT})
    site = rcs.Site(arms={"so101": place}, grippers={"so101": place}, arm_stale_after=PATIENT)
    return Collection(setup=rcs.Setup(robot="so101"), out=out, episodes=episodes, hardware=site, home_speed=0.5)


def test_cuboids_are_picked_recorded_at_30_hz_and_picked_again_in_simulation(tmp_path: Path) -> None:
    progress = Progress()
    with VirtualProcess("so101") as virtual:
        for _ in collect(collection(virtual, tmp_path / "real", 2), progress):
            pass
    assert [attempt.result.success for attempt in progress.attempts] == [True, True]
    assert not check(tmp_path / "real").damage
    for episode in Dataset.open(tmp_path / "real").episodes:
        periods = np.diff(episode.column("time/monotonic"))
        assert np.median(periods) == pytest.approx(1 / 30, rel=0.02)
        assert episode.outcome["objects"]["cuboid"]
    results = list(reexecute(tmp_path / "real", tmp_path / "simulated", kind="states"))
    assert [result.success for result in results] == [True, True]


def test_a_robot_that_fails_ends_the_collection_which_goes_on_when_it_is_mended(tmp_path: Path) -> None:
    with VirtualProcess("so101") as virtual:
        attempts = collect(collection(virtual, tmp_path / "real", 2), Progress())
        next(attempts)
        virtual.tell("cut")
        with pytest.raises(DeviceFault, match="on the servo bus"):
            next(attempts)
        virtual.tell("clear")
        progress = Progress()
        for _ in collect(collection(virtual, tmp_path / "real", 2), progress):
            pass
    assert (progress.found, progress.kept) == (1, 2)
