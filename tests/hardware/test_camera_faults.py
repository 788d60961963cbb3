"""A camera freezes, is unplugged, exchanged or black at random moments: no row is lost, no frame has a false time."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.robots.camera import CameraMount, looking
from rcs.virtual import VirtualProcess
from rcs.virtual.sensors import DRIFT, device_time

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]
MOMENTS = int(os.environ.get("RCS_CAMERA_MOMENTS", "4"))
"""Random moments for each reaction."""
STALE, LATE = 0.5, 0.1
STAY = {"joints": np.zeros(5), "gripper": np.ones(1, np.float32)}
FAULTS: tuple[tuple[Any, ...], ...] = (("freeze", 1.5), ("unplug", 1.5), ("swap", "diagonal"), ("black",))


@pytest.fixture(scope="module", params=["webcam", "realsense"])
def kind(request: pytest.FixtureRequest) -> str:
    if request.param == "realsense":
        pytest.importorskip("pyrealsense2", reason="needs the vendor's library and libusb", exc_type=ImportError)
    return request.param


@pytest.fixture(scope="module")
def cameras(kind: str) -> rcs.Cameras:
    if kind == "webcam":
        return rcs.Cameras(names=("wrist",), image_size=(320, 240), fps=15)
    d435 = CameraMount(camera="realsense_d435", optical=looking((0.6, 0.5, 0.5), (0.2, 0.0, 0.0)))
    return rcs.Cameras(mounts={"wrist": d435}, image_size=(320, 240), fps=30, depth=True)


@pytest.fixture(scope="module")
def served(cameras: rcs.Cameras, tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualProcess]:
    file = tmp_path_factory.mktemp("served") / "setup.json"
    setup = rcs.Setup(task="Free", robot="so101", cameras=replace(cameras, names=("wrist", "diagonal"), depth=False))
    file.write_text(json.dumps(setup.to_json()), "utf-8")
    with VirtualProcess("so101", setup=file, cameras=("wrist", "diagonal"), depth=cameras.depth) as process:
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
def test_at_random_moments(
    served: VirtualProcess, cameras: rcs.Cameras, kind: str, on_stale: Any, tmp_path: Path
) -> None:
    rng = np.random.default_rng(len(on_stale))
    site = rcs.Site(cameras={"wrist": served.site.cameras["wrist"]}, on_stale=on_stale, stale_after=STALE)
    assert served.site.cameras["wrist"].driver == kind
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
