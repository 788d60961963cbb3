"""Record RGB-D cameras of 640 x 480 px at 30 Hz next to a control loop of 100 Hz, with real codecs and disk.

The loop wakes up at fixed times, takes what the cameras show (drawn before, with the noise of real sensors), hands a
row to the recorder and goes back to sleep; threads encode and write. The reference, in the same run, is the same
loop with nothing recorded, and the processor time of encoding the same images alone.

Prints one JSON object: `core_fraction` (processor time of the process over wall time, recording),
`idle_core_fraction` (the same loop without recording), `codec_core_fraction` (encoding alone), `silent_drops` (images
that are neither in the dataset nor counted as dropped), `counted_drops`, `period_p50_ms`, `period_p99_ms`,
`period_max_ms`, `idle_p99_ms`, `megabytes_per_second`.
"""

from __future__ import annotations

import gc
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.files.codec import encode_frame
from rcs_data.files.flags import FrameFlag, flags_key, time_key
from rcs_data.record.background import BackgroundEpisode

import rcs

CAMERAS = ("wrist", "side")
LOOP_HZ, CAMERA_HZ = 100.0, 30.0
Frames = dict[str, list[dict[str, NDArray[Any]]]]


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    seconds: float = 20.0
    """Duration of the recording [s]."""
    warm_up: float = 1.0
    """Duration of the loop before the measurement [s]."""
    cameras: int = 2
    """Cameras; the third shows what the first does, and so on."""
    size: tuple[int, int] = (640, 480)
    """Width and height of the frames [px]."""
    frames: int = 30
    """Different frames per camera."""


def main(options: Options) -> None:
    """Measure and print."""
    print("drawing the cameras' frames", file=sys.stderr)
    frames = draw(options)
    idle_periods, idle_cpu, _ = run(frames, options, None)
    print(f"recording for {options.seconds:.0f} s", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder, DatasetWriter.open(Path(folder) / "dataset", info(frames)) as writer:
        episode = BackgroundEpisode(writer.episode("a", seed=0))
        periods, cpu, shown = run(frames, options, episode)
        record = episode.finish(True)
        size = sum(path.stat().st_size for path in record.path.iterdir())
        counted = episode.dropped_images
        images = [feature.key for feature in writer.info.features if feature.is_image]
        stored = sum(int(record.timing["cameras"][key]["new_images"]) for key in images)
    fraction = {"core_fraction": cpu, "idle_core_fraction": idle_cpu, "codec_core_fraction": codec_fraction(frames)}
    result = {
        **{name: round(value, 3) for name, value in fraction.items()},
        "silent_drops": shown - stored - counted,
        "counted_drops": counted,
        **{f"period_{name}_ms": round(1e3 * value, 3) for name, value in percentiles(periods).items()},
        "idle_p99_ms": round(1e3 * percentiles(idle_periods)["p99"], 3),
        "nominal_ms": 1e3 / LOOP_HZ,
        "images": shown,
        "megabytes_per_second": round(size / options.seconds / 1e6, 1),
    }
    print(json.dumps(result))


def draw(options: Options) -> Frames:
    """Return the frames of each camera: those of a simulated arm in motion, with the noise of real sensors."""
    env = rcs.make(
        "PickCuboid",
        robot="fr3",
        cameras=rcs.Cameras(names=CAMERAS, image_size=options.size, depth=True, noise=True),
        stepping="async",
    )
    observation, _ = env.reset(seed=0)
    frames: Frames = {camera: [] for camera in CAMERAS}
    env.action_space.seed(0)
    for _ in range(options.frames):
        for camera in CAMERAS:
            shown = observation["frames"][camera]
            frames[camera].append({"rgb": shown["rgb"].copy(), "depth": shown["depth"].copy()})
        observation, *_ = env.step(env.action_space.sample())
    env.close()
    return {f"camera{i}": frames[CAMERAS[i % len(CAMERAS)]] for i in range(options.cameras)}


def run(frames: Frames, options: Options, episode: BackgroundEpisode | None) -> tuple[NDArray[np.float64], float, int]:
    """Run the loop; return its periods [s], the share of a core that the process used, and the images shown."""
    period, steps = 1 / LOOP_HZ, round(options.seconds * LOOP_HZ)
    warm = round(options.warm_up * LOOP_HZ)
    number = dict.fromkeys(frames, -1)
    captured = dict.fromkeys(frames, 0.0)
    joints = np.zeros(7)
    stamps = np.zeros(steps + 1)
    shown = 0
    cpu = 0.0
    gc.collect()
    start = time.monotonic() - warm * period
    for step in range(-warm, steps + 1):
        due = start + (step + warm) * period + warm * period
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        if step < 0:
            continue
        stamps[step] = now
        if step == 0:
            cpu = time.process_time()
        row: dict[str, Any] = {"observation/joints": joints, "time/monotonic": now}
        for camera in frames:
            newest = int((now - start) * CAMERA_HZ)
            is_new = newest != number[camera]
            if is_new:
                number[camera], captured[camera] = newest, start + newest / CAMERA_HZ
                shown += 2
            image = frames[camera][newest % len(frames[camera])]
            for kind in ("rgb", "depth"):
                row[f"observation/frames/{camera}/{kind}"] = image[kind] if is_new else None
            row[time_key(camera)] = captured[camera]
            row[flags_key(camera)] = 0 if is_new else int(FrameFlag.REPEATED)
        if episode is not None:
            episode.add(row)
    used = time.process_time() - cpu
    return np.diff(stamps), used / (stamps[-1] - stamps[0]), shown


def info(frames: Frames) -> DatasetInfo:
    """Return what the dataset has."""
    features = [
        Feature(key="observation/joints", shape=(7,), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
    ]
    for camera, shown in frames.items():
        rgb, depth = shown[0]["rgb"].shape, shown[0]["depth"].shape
        features += [
            Feature(key=f"observation/frames/{camera}/rgb", shape=rgb, dtype="uint8", encoding="jpeg"),
            Feature(key=f"observation/frames/{camera}/depth", shape=depth, dtype="uint16", encoding="depth"),
            Feature(key=time_key(camera), shape=(), dtype="float64"),
            Feature(key=flags_key(camera), shape=(), dtype="uint8"),
        ]
    return DatasetInfo(frequency=LOOP_HZ, features=tuple(features), setup={}, instruction="")


def codec_fraction(frames: Frames) -> float:
    """Return the share of a core that encoding alone takes at the cameras' rate."""
    about = info(frames)
    start, n = time.process_time(), 0
    for camera in frames:
        for image in frames[camera]:
            for kind in ("rgb", "depth"):
                encode_frame(about.feature(f"observation/frames/{camera}/{kind}"), image[kind], about)
            n += 1
    return (time.process_time() - start) / n * len(frames) * CAMERA_HZ


def percentiles(periods: NDArray[np.float64]) -> dict[str, float]:
    """Return the median, the 99th percentile and the largest."""
    return {
        "p50": float(np.percentile(periods, 50)),
        "p99": float(np.percentile(periods, 99)),
        "max": float(periods.max()),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
