from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup, SimulationError
from rcs.robots.cameras import REALSENSE_D435
from rcs.robots.description import Mount
from rcs.sim import CameraPlacement, World
from rcs.sim.camera import FrameArrays, SimCameras, Snapshot
from rcs.sim.camera_feed import FrameClock, FrameRate, RenderThread
from rcs.sim.scene import Scene

pytestmark = pytest.mark.gl
SIZE = (40, 30)
RATES = {"fast": FrameRate(fps=60), "slow": FrameRate(fps=15)}
OPTIONS: dict[str, Any] = {"size": SIZE, "has_depth": True, "has_noise": True}


def placed(name: str, x: float, parent: str) -> CameraPlacement:
    """A camera a metre above a body, looking straight down."""
    down = Mount(translation=(x, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0))
    return CameraPlacement(name=name, camera=REALSENSE_D435, parent_body=parent, optical_in_parent=down)


PLACEMENTS = [placed("fast", 0.1, "world"), placed("slow", 0.05, "ball")]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """A ball that is pulled aside and carries the camera `slow`; `fast` sees it."""
    scene = Scene.empty()
    scene.spec.option.gravity = [5.0, 0.0, 0.0]
    body = scene.spec.worldbody.add_body(name="ball", pos=[0.0, 0.0, 0.5])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0.0, 0.0], rgba=[1, 0, 0, 1])
    for placement in PLACEMENTS:
        scene.add_camera(placement)
    return scene.compile()


@pytest.fixture
def world(model: mujoco.MjModel) -> World:
    world = World(model, frequency=60.0, stepping="realtime")
    world.reset()
    world.refresh()
    return world


class Gated(SimCameras):
    """Cameras whose drawing waits for permission to draw each snapshot, and which note what they drew."""

    permits: threading.Semaphore
    drawn: list[tuple[float, tuple[str, ...]]]

    def draw(self, snapshot: Snapshot, names: Sequence[str]) -> Iterator[tuple[str, FrameArrays]]:
        assert self.permits.acquire(timeout=60)
        self.drawn.append((snapshot.time, tuple(names)))
        yield from super().draw(snapshot, names)


@pytest.fixture
def gated(world: World) -> Iterator[tuple[RenderThread, Gated]]:
    cameras = Gated(world, PLACEMENTS, **OPTIONS)
    cameras.permits, cameras.drawn = threading.Semaphore(0), []
    thread = RenderThread(cameras, FrameClock(world, RATES))
    yield thread, cameras
    cameras.permits.release(1000)
    thread.close()


def wait_for(thread: RenderThread, name: str, captured: float) -> FrameArrays:
    """Read without stepping until a camera shows a state."""
    end = time.monotonic() + 60
    while True:
        frames = thread.read()
        if thread.capture_times[name] >= captured:
            return frames[name]
        assert time.monotonic() < end
        time.sleep(0.001)


def test_the_thread_draws_what_would_be_drawn_in_the_step_bit_for_bit(world: World) -> None:
    thread = RenderThread(SimCameras(world, PLACEMENTS, **OPTIONS), FrameClock(world, RATES))
    here = SimCameras(world, PLACEMENTS, **OPTIONS)
    shown = thread.read()
    for step in range(9):
        if step:
            world.advance()
            before = time.perf_counter()
            thread.read()
            shown = {"fast": wait_for(thread, "fast", before)}
            if step % 4 == 0:
                shown["slow"] = wait_for(thread, "slow", before)
        wanted = here.read()
        for name, frame in shown.items():
            assert list(frame) == list(wanted[name])
            for key, values in frame.items():
                np.testing.assert_array_equal(values, wanted[name][key], err_msg=f"{name} {key} {step}")
    thread.close()
    here.close()


def test_a_loop_never_waits_for_a_slow_renderer_and_what_it_skips_is_counted(
    world: World, gated: tuple[RenderThread, Gated]
) -> None:
    thread, cameras = gated
    cameras.permits.release()
    first = thread.read()
    newest = 0.0
    for _ in range(8):  # "slow" has a frame due in the 4th and in the 8th
        world.advance()
        newest = time.perf_counter()
        given = thread.read()  # nothing is drawn now, so this would wait for ever
        for name, key in (("fast", "rgb"), ("slow", "depth"), ("slow", "extrinsics")):
            assert given[name][key] is first[name][key]
    cameras.permits.release(1000)
    for name, due in (("fast", 9), ("slow", 3)):
        wait_for(thread, name, newest)
        drawn = [names for _, names in cameras.drawn if name in names]
        assert len(drawn) + thread.skipped[name] == due
    assert thread.skipped["fast"] >= 6, "one may have been under way"
    here = SimCameras(world, PLACEMENTS, **OPTIONS)
    np.testing.assert_array_equal(thread.read()["fast"]["rgb"], here.read()["fast"]["rgb"])
    here.close()


def test_an_episode_begins_with_its_own_frames_also_while_the_last_ones_are_drawn(
    world: World, gated: tuple[RenderThread, Gated]
) -> None:
    thread, cameras = gated
    cameras.permits.release()
    thread.read()
    world.advance()
    thread.read()
    skipped = dict(thread.skipped)
    world.reset()
    world.qpos[:2] = 0.2
    world.refresh()
    began = time.perf_counter()
    threading.Timer(0.05, cameras.permits.release, [2]).start()
    given = thread.read()
    here = SimCameras(world, PLACEMENTS, **OPTIONS)
    for name, frame in here.read().items():
        assert thread.capture_times[name] >= began
        for key, values in frame.items():
            np.testing.assert_array_equal(given[name][key], values)
    here.close()
    assert thread.skipped == skipped, "what is due in an episode that is over is no loss"


def test_frames_are_given_again_until_the_next_with_their_times_and_never_change(world: World) -> None:
    thread = RenderThread(SimCameras(world, PLACEMENTS, **OPTIONS), FrameClock(world, RATES))
    shown: dict[str, tuple[FrameArrays, float]] = {}
    handed_out: list[tuple[Any, Any]] = []
    for _ in range(40):
        given, now = thread.read(), time.perf_counter()
        for name, frame in given.items():
            captured = thread.capture_times[name]
            assert captured <= now
            if name in shown:
                before, time_before = shown[name]
                assert captured >= time_before
                for key, values in frame.items():
                    assert (values is before[key]) == (captured == time_before)
                    with pytest.raises(ValueError, match="read-only"):
                        values[...] = 0
            handed_out += [(values, values.copy()) for values in frame.values()]
            shown[name] = frame, captured
        world.advance()
    thread.close()
    for values, kept in handed_out:
        np.testing.assert_array_equal(values, kept)


def test_what_fails_in_the_thread_is_raised_by_read(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> Any:
        raise SimulationError("too many geoms")

    thread = RenderThread(SimCameras(world, PLACEMENTS, **OPTIONS), FrameClock(world, RATES))
    with monkeypatch.context() as patch:
        patch.setattr(SimCameras, "draw", fail)
        for _ in range(2):
            with pytest.raises(SimulationError, match="too many geoms"):
                thread.read()
    thread.close()
    assert set(thread.read()) == {"fast", "slow"}, "after a close it starts anew"
    thread.close()


def test_closing_ends_the_thread_and_twice_is_harmless(world: World) -> None:
    thread = RenderThread(SimCameras(world, PLACEMENTS, **OPTIONS), FrameClock(world, RATES))
    thread.close()
    thread.read()
    thread.close()
    thread.close()
    assert not [other for other in threading.enumerate() if other.name.startswith("render cameras")]


def test_many_copies_are_refused(model: mujoco.MjModel) -> None:
    world = World(model, frequency=60.0, copies=2)
    with pytest.raises(InvalidSetup, match="CameraFeed"):
        RenderThread(SimCameras(world, PLACEMENTS, size=SIZE), FrameClock(world, RATES))
