"""Compare the samples per second of our loader and LeRobot's on the same episodes, in turns on the same two cores.

The dataset is collected here: scripted episodes with two cameras of 224 x 224 pixels, and exported to LeRobot v3.0 as
H.264 and as AV1, LeRobot's default. A sample is one observation with both images and 16 actions; a batch has 64, in
random order. LeRobot decodes with torchcodec, in an environment of its own (build/peers/lerobot, made when missing: 2
GB); ours reads the dataset as it was recorded, as JPEG.

Prints one JSON object: per loader and number of workers samples per second, medians, and `times_lerobot`: how many
times LeRobot's rate of H.264 ours of JPEG is.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import tyro
from rcs_data import Dataset
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.options import ExportOptions
from vlagents.policies import catalogue

import rcs
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress

HERE = Path(__file__).parent
PLACE = HERE.parents[1] / "build" / "peers" / "lerobot"
PACKAGE = HERE.parents[1] / "packages" / "vlagents"


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    episodes: int = 16
    """Episodes to collect."""
    rounds: int = 3
    """Rounds, in each of which every loader runs for ten seconds."""
    workers: tuple[int, ...] = (0, 2)
    """Workers of the loaders; each number is measured."""
    cores: str = "0,1"
    """Cores that all of them run on."""
    python: Path = PLACE / "bin" / "python"
    """A Python with LeRobot 0.4.4 and torchcodec; by default one made by `vlagents recipe lerobot`."""


def main(options: Options) -> None:
    """Measure and print."""
    stamp = PLACE / ".stamp"
    if options.python.is_relative_to(PLACE) and not stamp.exists():
        print(f"making {PLACE}", file=sys.stderr)
        made = {**os.environ, "VLAGENTS": str(PACKAGE)}
        subprocess.run(["sh", "-s", "--", PLACE], input=catalogue.recipe("lerobot"), env=made, check=True, text=True)
        stamp.touch()
    with tempfile.TemporaryDirectory() as folder:
        loaders = prepared(Path(folder), options)
        rates: dict[tuple[str, int], list[float]] = defaultdict(list)
        for turn in range(options.rounds):
            for workers in options.workers:
                for name, (python, program, data) in loaders.items():
                    rates[name, workers].append(rate(python, program, data, workers, options.cores))
                    print(f"{turn + 1}: {name}, {workers} workers: {rates[name, workers][-1]:.0f}/s", file=sys.stderr)
    found = {key: median(values) for key, values in rates.items()}
    result = {name: {workers: round(found[name, workers], 1) for workers in options.workers} for name in loaders}
    times = {n: round(found["rcs jpeg", n] / found["lerobot h264", n], 1) for n in options.workers}
    print(json.dumps({"benchmark": "peer_loader", "samples_per_second": result, "times_lerobot": times}))


def prepared(folder: Path, options: Options) -> dict[str, tuple[Path, str, Path]]:
    """Collect and export; return each loader's Python, program and data."""
    setup = rcs.Setup(
        task="PickCuboid", robot="fr3", cameras=rcs.Cameras(names=("wrist", "side"), image_size=(224, 224))
    )
    for _ in collect(Collection(setup=setup, out=folder / "jpeg", episodes=options.episodes, seed=1), Progress()):
        pass
    for codec in ("h264", "av1"):
        export_lerobot(Dataset.open(folder / "jpeg"), folder / f"lerobot-{codec}", ExportOptions(codec=codec))
    ours, theirs = (Path(sys.executable), "rcs_loader.py"), (options.python, "lerobot_loader.py")
    return {
        "rcs jpeg": (*ours, folder / "jpeg"),
        "lerobot h264": (*theirs, folder / "lerobot-h264"),
        "lerobot av1": (*theirs, folder / "lerobot-av1"),
    }


def rate(python: Path, program: str, data: Path, workers: int, cores: str) -> float:
    """Return the samples per second that a program prints."""
    command = ["taskset", "-c", cores, python, HERE / program, data, str(workers)]
    quiet = {**os.environ, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600, env=quiet)
    if answer.returncode:
        raise SystemExit(f"{program} ended with {answer.returncode}:\n{answer.stderr[-2000:]}")
    return float(json.loads(answer.stdout.splitlines()[-1])["samples_per_second"])


if __name__ == "__main__":
    main(tyro.cli(Options))
