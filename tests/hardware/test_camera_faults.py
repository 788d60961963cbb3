"""A camera freezes, is unplugged, exchanged or black at random moments: no row is lost, no frame has a false time."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.virtual import VirtualProcess
from rcs.virtual.sensors import DRIFT, device_time

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]
MOMENTS = int(os.environ.get("RCS_CAMERA_MOMENTS", "4"))
"""Random moments for each reaction."""
STALE, LATE = 0.5, 0.1
STAY = {"joints": np.zeros(5), "gripper": np.ones(1, np.float32)}
FAULTS: tuple[tuple[Any, ...], ...] = (("freeze", 1.5), ("unplug", 1.5), ("swap", "diagonal"), ("black",))


@pytest.fixture(scope="module")
def served() -> Iterator[VirtualProcess]:
    with VirtualProcess("so101", cameras=("wrist", "diagonal")) as process:
        yield process


def followed(env: Any, *, until: float) -> list[dict[str, Any]]:
    """Step for some seconds or to the end of the episode, and return the infos."""
    infos: list[dict[str, Any]] = []
    end = time.monotonic() + until
    while time.monotonic() < end:
        *_, truncated, info = env.step(STAY)
        infos.append(info)
        if truncated:
            break
    return infos


@pytest.mark.parametrize("on_stale", ["fault", "hold", "flag"])
def test_at_random_moments(served: VirtualProcess, on_stale: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(len(on_stale))
    cameras = rcs.Cameras(names=("wrist",), image_size=(320, 240), fps=15)
    site = rcs.Site(cameras=served.site.cameras, on_stale=on_stale, stale_after=STALE)
    for moment in range(MOMENTS):
        fault = FAULTS[moment % len(FAULTS)]
        served.tell("wrist/clear")
        setup = rcs.Setup(task="Free", robot="so101", cameras=cameras, frequency=50, max_episode_steps=None)
        env = rcs.make(setup, hardware=site)
        out = tmp_path / str(moment)
        steps = 0
        with rcs.record(env, out) as takes:
            takes.start(at_reset=True)
            env.reset()
            steps += len(followed(env, until=rng.uniform(0.2, 1.0)))
            served.tell(f"wrist/{fault[0]}", *fault[1:])
            infos = followed(env, until=2.5)
            steps += len(infos)
            outcome = {
                "fault": infos[-1]["end"] == "fault" and "wrist" in infos[-1]["faults"],
                "hold": any("wrist" in str(info.get("refused", "")) for info in infos),
                "flag": max(info["ages"]["frames/wrist"] for info in infos) > STALE,
            }
            if fault == ("black",):
                assert not any(outcome.values()), (fault, infos[-1])
                assert env.step(STAY)[0]["frames"]["wrist"]["rgb"].max() < 5, "a black picture is a picture"
                steps += 1
            else:
                assert outcome[on_stale], (fault, infos[-1])
            if takes.is_recording:
                takes.finish(None)
            begin = time.monotonic()
            env.close()
            assert time.monotonic() - begin < 1.5
        episode = Dataset.open(out).episodes[0]
        assert episode.length == steps + 1, "no row is lost"
        seen, at = episode.column("time/frames/wrist"), episode.column("time/device/frames/wrist")
        truth = (at - device_time("wrist", 0.0)) / (1.0 - DRIFT)
        assert np.abs(seen - truth).max() < LATE, (fault, np.abs(seen - truth).max())
