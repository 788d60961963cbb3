"""Measure the rate at which virtual FR3s are controlled and recorded, with cameras and DIGITs, over their wires.

    python benchmarks/frequency.py [--arms 1] [--cameras 2] [--depth] [--tactile 0]
        [--rates 10 30 60 90 120 150 200]

The experiment of the paper's figure on frequencies: cameras of 1280 x 720 px at 30 frames/s, DIGITs of 320 x 240 px at
60, one or two arms with hands, everything recorded, a scripted operator that moves a joint to and fro. A virtual robot
draws its cameras on the same machine, so run this on one with enough processors; `processors` says how many there were.
`--depth` serves the cameras with depth for the library of RealSense cameras, instead of as webcams; `--size 640 480` is
another size. `--tactile 2` puts two DIGITs on each arm, four on two; `tactile` says how many are read.

Prints one line of JSON per rate: `rate_hz` (1 / mean period) and `std_hz` (standard deviation of 1 / period),
`period_p50_ms`, `period_p99_ms` (of the deviation from the wanted period), `silent_drops` (steps that are neither in
the recording nor counted as dropped), `dropped_images`, the age of frames at the end of steps, and `age_error_p99_ms`,
by how much it is off the moment at which the virtual world was drawn. `--figure FILE.svg` draws the figure.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import Dataset, EpisodeRecord

import rcs
from rcs.hardware import Site
from rcs.robots.camera import CameraMount, looking
from rcs.setups.lab import lab_of
from rcs.virtual import VirtualProcess
from rcs.virtual.sensors import DRIFT, device_time

SIZE, FPS = (1280, 720), 30
WRIST = looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0))
MORE = {
    "hand": CameraMount(camera="realsense_d405", optical=WRIST, on_gripper_of="fr3"),
    "beside": CameraMount(camera="realsense_d435", optical=looking((0.5, 0.9, 0.5), (0.5, 0.0, 0.05))),
    "front": CameraMount(camera="realsense_d435", optical=looking((1.3, 0.0, 0.6), (0.45, 0.0, 0.05))),
    "above": CameraMount(camera="realsense_d435", optical=looking((0.9, 0.0, 1.1), (0.45, 0.0, 0.0))),
}
"""Cameras that the labs do not have; those of one FR3 are calibrated in another shape."""
LABS = {
    1: ("fr3", ("hand", "beside", "front", "above")),
    2: ("dual_fr3", ("front", "left_wrist", "right_wrist", "above")),
}
"""Robots and their cameras, by number of arms."""
STROKE = 0.2
"""Largest speed of the joint that moves [rad/s]."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    arms: Literal[1, 2] = 1
    """Number of arms."""
    cameras: Literal[0, 1, 2, 3, 4] = 2
    """Number of cameras."""
    depth: bool = False
    """Record depth, too."""
    size: tuple[int, int] = SIZE
    """Width and height of the pictures [px]."""
    tactile: Literal[0, 2] = 0
    """Number of DIGITs on each arm."""
    rates: tuple[float, ...] = (10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 200.0)
    """Control rates [Hz]."""
    steps: int = 1000
    """Steps at each rate."""
    address: str = "127.0.0.31"
    """Address of the first virtual arm."""
    figure: Path | None = None
    """SVG file of the figure."""


def main(options: Options) -> None:
    """Measure and print."""
    robot, names = LABS[options.arms][0], LABS[options.arms][1][: options.cameras]
    own = lab_of(robot).cameras
    mounts = {name: MORE[name] for name in names if name not in own}
    cameras = rcs.Cameras(names=names, mounts=mounts, image_size=options.size, fps=FPS, depth=options.depth)
    tactile = "digit" if options.tactile else None
    setup = rcs.Setup(task="Free", robot=robot, cameras=cameras, tactile=tactile, max_episode_steps=None)
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "setup.json"
        file.write_text(json.dumps(setup.to_json()))
        served = {"cameras": names, "depth": options.depth, "tactile": bool(options.tactile)}
        with VirtualProcess(robot, address=options.address, setup=file, **served) as virtual:
            for rate in options.rates:
                measured = measure(setup, virtual.site, rate, options.steps, Path(folder) / f"{rate:g}")
                about = {"arms": options.arms, "cameras": len(names), "size": options.size, "depth": options.depth}
                about["tactile"] = len(virtual.site.tactile)
                found.append({"benchmark": "frequency", **about, **measured, "processors": os.cpu_count()})
                print(json.dumps(found[-1]), flush=True)
    if options.figure is not None:
        options.figure.write_text(drawn(found))


def measure(setup: rcs.Setup, site: Site, rate: float, steps: int, out: Path) -> dict[str, Any]:
    """Control and record at one rate."""
    loose = replace(site, on_stale="flag")
    with rcs.make(replace(setup, frequency=rate), hardware=loose) as env, rcs.record(env, out) as takes:
        takes.start(at_reset=True)
        env.reset()
        made, ages = 0, list[float]()
        for step in range(steps):
            *_, truncated, info = env.step(operated(env, step / rate, rate))
            made += 1
            ages += [age for key, age in info["ages"].items() if key.startswith("frames/")]
            if truncated:
                raise SystemExit(f"The episode ended after {made} steps: {info['end']} {info.get('faults')}")
        takes.finish(None)
    episode = Dataset.open(out).episodes[0]
    periods = np.diff(episode.column("time/monotonic"))
    writer = episode.timing.get("writer") or {}
    dropped = int(writer.get("dropped_rows", 0))
    late = np.abs(periods - 1.0 / rate)
    errors = [age_errors(episode, name) for name in (*site.cameras, *site.tactile)]
    return {
        "wanted_hz": rate,
        "rate_hz": 1.0 / float(periods.mean()),
        "std_hz": float((1.0 / periods).std()),
        "period_p50_ms": 1e3 * float(np.percentile(late, 50)),
        "period_p99_ms": 1e3 * float(np.percentile(late, 99)),
        "silent_drops": made + 1 - episode.length - dropped,
        "dropped_rows": dropped,
        "dropped_images": int(writer.get("dropped_images", 0)),
        "age_p50_ms": 1e3 * float(np.percentile(ages, 50)) if ages else None,
        "age_p99_ms": 1e3 * float(np.percentile(ages, 99)) if ages else None,
        "age_error_p99_ms": 1e3 * float(np.percentile(np.concatenate(errors), 99)) if errors else None,
    }


def age_errors(episode: EpisodeRecord, name: str) -> NDArray[np.float64]:
    """Return by how much each time of a virtual sensor's frames is off the moment that they show [s]."""
    seen, at = episode.column(f"time/frames/{name}"), episode.column(f"time/device/frames/{name}")
    return np.abs(seen - (at - device_time(name, 0.0)) / (1.0 - DRIFT))


def operated(env: Any, moment: float, rate: float) -> dict[str, Any]:
    """Return an action of the operator: the last joint but one goes to and fro, relative to the last step."""
    joints = np.zeros(7)
    joints[5] = STROKE * np.cos(2.0 * np.pi * 0.25 * moment) / rate
    one = {"joints": joints, "gripper": np.ones(1, np.float32)}
    return one if len(env.robots) == 1 else dict.fromkeys(env.robots, one)


def drawn(found: Sequence[dict[str, Any]]) -> str:
    """Return the figure: measured over wanted rate, the standard deviation shaded, the ideal as a dashed line."""
    width, height, margin = 640, 480, 60
    top = 1.1 * max(max(one["wanted_hz"], one["rate_hz"] + one["std_hz"]) for one in found)

    def at(wanted: float, got: float) -> str:
        x = margin + wanted / top * (width - 1.5 * margin)
        return f"{x:.1f},{height - margin - max(got, 0.0) / top * (height - 1.5 * margin):.1f}"

    upper = [at(one["wanted_hz"], one["rate_hz"] + one["std_hz"]) for one in found]
    lower = [at(one["wanted_hz"], one["rate_hz"] - one["std_hz"]) for one in reversed(found)]
    line = [at(one["wanted_hz"], one["rate_hz"]) for one in found]
    ticks = np.arange(0.0, top, 20.0 if top < 250 else 50.0)
    numbers = "".join(
        f'<text x="{at(one, 0.0).split(",")[0]}" y="{height - margin + 20}" text-anchor="middle">{one:g}</text>'
        f'<text x="{margin - 8}" y="{at(0.0, one).split(",")[1]}" text-anchor="end">{one:g}</text>'
        for one in ticks
    )
    title = f"{found[0]['arms']} FR3, {found[0]['cameras']} cameras, {found[0]['tactile']} DIGITs"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="13">'
        f'<rect width="{width}" height="{height}" fill="white"/><text x="{margin}" y="24">{title}</text>'
        f'<polyline points="{at(0, 0)} {at(top, 0)}" stroke="#888" fill="none"/>'
        f'<polyline points="{at(0, 0)} {at(0, top)}" stroke="#888" fill="none"/>'
        f'<polyline points="{at(0, 0)} {at(top, top)}" stroke="#888" stroke-dasharray="4 4" fill="none"/>'
        f'<polygon points="{" ".join(upper + lower)}" fill="#1f77b4" opacity="0.25"/>'
        f'<polyline points="{" ".join(line)}" stroke="#1f77b4" stroke-width="2" fill="none"/>{numbers}'
        f'<text x="{width / 2}" y="{height - 15}" text-anchor="middle">control frequency [Hz]</text>'
        f'<text x="18" y="{height / 2}" transform="rotate(-90 18 {height / 2})" text-anchor="middle">'
        "recorded frequency [Hz]</text></svg>\n"
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
