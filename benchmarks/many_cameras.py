"""Record six cameras of 1280 x 720 at 30 Hz next to a loop of 90 Hz in real time, with real codecs and disk.

The frames were drawn before by the simulator, with the noise of real sensors; each camera gives them at its rate, as a
device does. The loop wakes up at fixed times, hands a row to the recorder and goes back to sleep; a pool of threads
encodes and writes. The references, in the same run: the same loop with a single encoding thread, and with nothing
recorded.

Then cameras are truly drawn, by a render thread beside a simulation that is stepped at 90 Hz in real time, and, as the
reference, inside of the step.

Prints one JSON object: `pool`, `one_thread` and `idle` (each with the loop's lateness [ms], and the images that were
shown, recorded, counted as dropped, and neither of these: `unflagged`), and `drawn` (by number of cameras: frames per
second of each, the age of the frame that a step sees [ms], and lateness).
"""

from __future__ import annotations

import gc
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.files.flags import FrameFlag, flags_key, time_key
from rcs_data.record.background import BackgroundEpisode, Encoders

import rcs
from rcs.envs.assemble import assemble
from rcs.envs.parts import Parts
from rcs.robots.camera import looking
from rcs.setups.make import resolve
from rcs.sim.camera import SimCameras
from rcs.sim.camera_feed import CameraFeed, FrameClock, FrameRate, RenderThread

WIDTH, HEIGHT = 1280, 720
VIEWS = {"left": (0.6, 0.8, 0.5), "right": (0.6, -0.8, 0.5), "front": (1.4, 0.0, 0.5), "above": (0.5, 0.1, 1.2)}
"""Positions of additional cameras, which look at the middle of the table."""
Frames = dict[str, list[NDArray[np.uint8]]]


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    seconds: float = 20.0
    """Duration of each loop [s]."""
    loop_hz: float = 90.0
    """Rate of the loop [Hz]."""
    camera_hz: float = 30.0
    """Rate of each camera [Hz]."""
    frames: int = 10
    """Different frames per camera."""


@dataclass
class Loop:
    """Lateness and processor time of a loop at a fixed rate."""

    late: NDArray[np.float64]
    """Delay of the start of each step [s]."""
    seconds: float
    cpu: float
    """Processor time of the process over wall time."""

    def summary(self) -> dict[str, float]:
        """Return the figures, rounded."""
        late = 1e3 * self.late
        figures = {"mean": late.mean(), "p99": np.percentile(late, 99), "max": late.max()}
        told = {f"late_{name}_ms": round(float(value), 3) for name, value in figures.items()}
        return {"seconds": round(self.seconds, 2), "steps": len(late), **told, "core_fraction": round(self.cpu, 3)}


def main(options: Options) -> None:
    """Measure and print."""
    print("drawing the cameras' frames", file=sys.stderr)
    parts = six_cameras()
    frames = draw(parts, options.frames)
    idle = keep_rate(options.loop_hz, options.seconds, lambda step, now: None).summary()
    pool = record(frames, options, None)
    one_thread = record(frames, options, 1)
    print("drawing beside the loop", file=sys.stderr)
    drawn = {
        name: {f"{count} cameras": draw_live(parts, count, options, in_thread=name == "thread") for count in (1, 2, 6)}
        for name in ("thread", "in_step")
    }
    print(
        json.dumps({"benchmark": "many_cameras", "pool": pool, "one_thread": one_thread, "idle": idle, "drawn": drawn})
    )


def six_cameras() -> Parts:
    """Return the lab of the FR3 with its two cameras and four more."""
    setup = rcs.Setup(
        task="PickCuboid",
        robot="fr3",
        cameras=rcs.Cameras(names=("wrist", "side"), image_size=(WIDTH, HEIGHT), noise=True),
    )
    parts = resolve(setup)
    side = parts.cameras[1]
    more = [
        replace(
            side, name=name, parent_body="world", optical_in_parent=looking(place, (0.4, 0.0, 0.0)), calibration=None
        )
        for name, place in VIEWS.items()
    ]
    return replace(parts, cameras=(*parts.cameras, *more))


def draw(parts: Parts, n: int) -> Frames:
    """Return n frames per camera of an arm in motion."""
    env = assemble(parts)
    observation, _ = env.reset(seed=0)
    frames: Frames = {camera.name: [] for camera in parts.cameras}
    env.action_space.seed(0)
    for _ in range(n):
        for name, taken in frames.items():
            taken.append(observation["frames"][name]["rgb"])
        observation, *_ = env.step(env.action_space.sample())
    env.close()
    return frames


def keep_rate(rate: float, seconds: float, step: Callable[[int, float], object]) -> Loop:
    """Call `step(number, now)` at a rate; when a call takes too long, the next ones come as soon as they can."""
    late = np.zeros(round(seconds * rate))
    gc.collect()
    start, cpu = time.monotonic() + 0.1, time.process_time()
    for i in range(len(late)):
        due = start + i / rate
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        late[i] = now - due
        step(i, now)
    seconds = time.monotonic() - start
    return Loop(late, seconds, (time.process_time() - cpu) / seconds)


def record(frames: Frames, options: Options, threads: int | None) -> dict[str, Any]:
    """Record beside the loop; `threads` is None for the threads that a process has by default."""
    print(f"recording for {options.seconds:.0f} s", file=sys.stderr)
    about = info(list(frames), options.loop_hz)
    images = [feature.key for feature in about.features if feature.is_image]
    with (
        tempfile.TemporaryDirectory() as folder,
        Encoders(threads) as encoders,
        DatasetWriter.open(Path(folder) / "dataset", about) as writer,
    ):
        episode = BackgroundEpisode(writer.episode("a", seed=0), about, encoders=encoders)
        cameras = ReplayedCameras(frames, options.camera_hz)
        loop = keep_rate(options.loop_hz, options.seconds, lambda _, now: episode.add(cameras.row(now)))
        record = episode.finish(True)
        size = sum(path.stat().st_size for path in record.path.iterdir())
        stored = sum(int(record.timing["cameras"][key]["new_images"]) for key in images)
        flagged = sum(int(np.count_nonzero(record.flags(camera) & FrameFlag.DROPPED)) for camera in frames)
        assert record.length == len(loop.late), "rows were dropped"
        return {
            "encoder_threads": encoders.threads,
            **loop.summary(),
            "images": cameras.shown,
            "recorded": stored,
            "counted_drops": episode.dropped_images,
            "unflagged": cameras.shown - stored - flagged,
            "most_megabytes_waiting": round(record.timing["writer"]["most_bytes_waiting"] / 1e6, 1),
            "megabytes_per_second": round(size / loop.seconds / 1e6, 1),
        }


class ReplayedCameras:
    """Cameras that give frames at their rate, out of phase, and in between the last one again."""

    def __init__(self, frames: Frames, rate: float) -> None:
        """Start with the first row."""
        self.shown = 0
        self._frames = frames
        self._rate = rate
        self._start: float | None = None
        self._numbers = dict.fromkeys(frames, -1)

    def row(self, now: float) -> dict[str, Any]:
        """Return the row of a step."""
        self._start = now if self._start is None else self._start
        row: dict[str, Any] = {"observation/joints": np.zeros(7), "time/monotonic": now}
        for i, (camera, taken) in enumerate(self._frames.items()):
            phase = i / len(self._frames)
            number = int((now - self._start) * self._rate + phase)
            is_new = number != self._numbers[camera]
            self._numbers[camera] = number
            self.shown += is_new
            row[image_key(camera)] = taken[number % len(taken)] if is_new else None
            row[time_key(camera)] = self._start + (number - phase) / self._rate
            row[flags_key(camera)] = 0 if is_new else int(FrameFlag.REPEATED)
        return row


def info(cameras: list[str], rate: float) -> DatasetInfo:
    """Return what the dataset has."""
    features = [
        Feature(key="observation/joints", shape=(7,), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
    ]
    for camera in cameras:
        features += [
            Feature(key=image_key(camera), shape=(HEIGHT, WIDTH, 3), dtype="uint8", encoding="jpeg"),
            Feature(key=time_key(camera), shape=(), dtype="float64"),
            Feature(key=flags_key(camera), shape=(), dtype="uint8"),
        ]
    return DatasetInfo(frequency=rate, features=tuple(features), setup={}, instruction="")


def image_key(camera: str) -> str:
    """Return the key of a camera's image."""
    return f"observation/frames/{camera}/rgb"


def draw_live(parts: Parts, count: int, options: Options, *, in_thread: bool) -> dict[str, float]:
    """Step a simulation in real time beside cameras that are truly drawn, without noise."""
    setup = replace(parts.setup, stepping="realtime", frequency=options.loop_hz)
    env = assemble(replace(parts, setup=setup), is_blind=True)
    env.reset(seed=0)
    world, placements = env.simulation.world, list(parts.cameras[:count])
    cameras = SimCameras(world, placements, size=(WIDTH, HEIGHT))
    clock = FrameClock(world, {placement.name: FrameRate(fps=options.camera_hz) for placement in placements})
    feed = RenderThread(cameras, clock) if in_thread else CameraFeed(cameras, clock)
    feed.read()
    frames: set[tuple[str, float]] = set()
    ages: list[float] = []

    def step(_: int, now: float) -> None:
        world.advance()
        feed.read()
        frames.update(feed.capture_times.items())
        ages.extend(time.perf_counter() - captured for captured in feed.capture_times.values())

    loop = keep_rate(options.loop_hz, options.seconds / 2, step)
    feed.close()
    env.close()
    return {
        "fps_per_camera": round(len(frames) / count / loop.seconds, 2),
        "age_mean_ms": round(1e3 * float(np.mean(ages)), 1),
        **loop.summary(),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
