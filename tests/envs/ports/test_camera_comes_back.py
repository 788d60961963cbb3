"""A camera that is gone for some time does not keep episodes from beginning, and counts in its own episode alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from rcs_data import Dataset

from rcs.devices import CameraMode
from rcs.devices.fakes import FakeCamera
from rcs.envs.observers.record import record
from rcs.errors import InvalidSetup
from rcs.hardware.usb import Plug, UsbDevice, find
from tests.envs.ports.test_camera import make, stay, wait_for

MODE = CameraMode(640, 480, 30.0, False)


def test_a_camera_that_is_unplugged_between_episodes_keeps_none_from_beginning() -> None:
    class Plugged(FakeCamera):
        is_in = True

        def plug(self) -> Plug:
            there = [UsbDevice(path="1-2", serial="A1", speed=480)] if self.is_in else []
            return Plug(device=find("A1", there, "webcam"), needs=1)

    plugged = Plugged(MODE, name="side")
    env = make(plugged, on_stale="flag", stale_after=60.0)
    env.reset(seed=0)
    plugged.is_in = False
    plugged.lose_link()
    env.reset(seed=1)
    env.step(stay(env))
    env.close()
    with make(plugged) as another, pytest.raises(InvalidSetup, match="A1"):
        another.reset(seed=0)


def test_a_recording_counts_the_reconnections_of_its_own_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.RECONNECT", 0.01)
    camera = FakeCamera(MODE, name="side")
    env = make(camera, on_stale="flag", max_episode_steps=None)
    with record(env, tmp_path / "takes") as takes:
        for is_lost in (True, False):
            takes.start(at_reset=True)
            _, info = env.reset(seed=0)
            assert ("reconnections" in info) == (not is_lost), "those of the first episode"
            env.step(stay(env))
            if is_lost:
                camera.lose_link()
                wait_for(lambda: env.step(stay(env))[-1]["ages"]["frames/side"] > 0.2)
                camera.restore()
                wait_for(lambda: "reconnections" in env.step(stay(env))[-1])
            takes.finish(None)
    env.close()
    episodes = Dataset.open(tmp_path / "takes").episodes
    assert episodes[0].outcome["reconnections"]["frames/side"] >= 1
    assert "reconnections" not in episodes[1].outcome
