"""Measure the cost of operations on growing datasets, as the exponent of seconds over episodes.

Datasets of more and more short episodes (20 rows of numbers) are recorded, and each operation runs once on each, as a
process of its own on one core: its processor seconds without the start of Python and its packages, which is measured
beside it, and the most memory it had. A tenth more than linear is an exponent of 1.04 from 1 000 to 10 000.

`--gigabytes` records one episode with images of that size besides, and reports what checking, editing and exporting it
needs in memory. Prints one JSON object: by operation the seconds at each size, MB at the largest, and the exponent
between the two largest.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rcs_data import DatasetInfo, DatasetWriter, Feature

PREPARE = (
    "import sys, rcs_data; from rcs_data import Dataset, check, convert, edit, Windows; path, other = sys.argv[1:]\n"
)
OPERATIONS = {
    "open": "Dataset.open(path)",
    "info": "from rcs_data.cli.view import InfoCommand; InfoCommand(path=path).run()",
    "check_fast": "assert check(path, depth='bytes', workers=1).is_ok",
    "check_rows": "assert check(path, depth='rows', workers=1).is_ok",
    "windows": "Windows(Dataset.open(path))",
    "random_rows": (
        "import random; w = Windows(Dataset.open(path))\n"
        "w.batch(random.Random(0).sample(range(len(w)), min(2000, len(w))))"
    ),
    "relabel_one": "edit.relabel(path, 'push', episodes=['000001'])",
    "delete_one": "edit.delete(path, ['000002'])",
    "undo": "edit.undo(path)",
    "keep": "edit.keep(path, [e.id for e in Dataset.open(path) if e.success])",
    "undo_keep": "edit.undo(path)",
    "split": "edit.split(path, other + '-parts', parts={'train': 0.9, 'val': 0.1})",
    "merge": "edit.merge([path, other + '-parts/train'], other + '-merged')",
    "export": "convert.export_lerobot(Dataset.open(path), other + '-lerobot')",
    "import": "convert.import_lerobot(other + '-lerobot', other + '-imported')",
    "view": "from rcs_data.view import write_view; write_view(path)",
}
# The most memory of this process alone; the figure of `wait4` begins with that of its parent.
MEMORY = "\nprint(next(line for line in open('/proc/self/status') if line.startswith('VmHWM')).split()[1])\n"
FEATURES = (
    Feature(key="observation/joints", shape=(7,), dtype="float64"),
    Feature(key="action/joints", shape=(7,), dtype="float64"),
    Feature(key="reward", shape=(), dtype="float64"),
    Feature(key="terminated", shape=(), dtype="bool"),
    Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
)
RGB = "observation/frames/side/rgb"


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    sizes: tuple[int, ...] = (100, 1000, 10000)
    """Numbers of episodes."""
    only: tuple[str, ...] = ()
    """Operations; all if none are given."""
    gigabytes: float = 0.0
    """Size of the images of one long episode; 0 for none."""


def main(options: Options) -> None:
    """Measure and print."""
    chosen = {name: program for name, program in OPERATIONS.items() if not options.only or name in options.only}
    told: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        start = run("pass", Path(folder), Path(folder))[0]
        for size in options.sizes:
            path, other = Path(folder) / f"{size}", Path(folder) / f"{size}-made"
            begin = time.process_time()
            record(path, size)
            told.setdefault("write", {})[str(size)] = round(time.process_time() - begin, 3)
            for name, program in chosen.items():
                seconds, megabytes = run(program, path, other)
                told.setdefault(name, {})[str(size)] = round(max(seconds - start, 0.001), 3)
                told[name]["mb"] = megabytes
                print(f"{size} {name}: {seconds - start:.2f} s, {megabytes} MB", file=sys.stderr)
        if options.gigabytes:
            path, other = Path(folder) / "long", Path(folder) / "long-made"
            for name, program in LONG.items():
                seconds, megabytes = run(program.format(gigabytes=options.gigabytes), path, other)
                told[f"long {name}"] = {"s": round(seconds - start, 1), "mb": megabytes}
                print(f"long {name}: {seconds - start:.1f} s, {megabytes} MB", file=sys.stderr)
    if len(options.sizes) > 1:
        small, large = options.sizes[-2:]
        for name, found in told.items():
            if str(large) in found:
                ratio = found[str(large)] / found[str(small)]
                told[name]["exponent"] = round(math.log(ratio) / math.log(large / small), 2)
    print(json.dumps({"benchmark": "scale", **told}))


LONG = {
    "record": "from scale import *; record_long(Path(path), {gigabytes})",
    "check": "assert check(path, workers=1).is_ok",
    "trim": "edit.trim(path, 'long', first=10, last=-10)",
    "rename": "edit.rename_camera(path, 'side', 'front')",
    "resample": "edit.resample(path, 15)",
    "export": "convert.export_lerobot(Dataset.open(path), other + '-lerobot')",
}


def run(program: str, path: Path, other: Path) -> tuple[float, int]:
    """Run an operation as a process on one core; return its processor seconds and its most memory [MB]."""
    command = ["taskset", "-c", str(min(os.sched_getaffinity(0))), sys.executable, "-c", PREPARE + program + MEMORY]
    here = Path(__file__).parent  # where `record_long` is found
    with subprocess.Popen([*command, str(path), str(other)], stdout=subprocess.PIPE, text=True, cwd=here) as child:
        assert child.stdout is not None
        told = child.stdout.read()
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{program} ended with {child.returncode}")
    return used.ru_utime + used.ru_stime, int(told.split()[-1]) // 1024


def record(path: Path, episodes: int) -> None:
    """Record short episodes without images, half of which succeed."""
    info = DatasetInfo(frequency=30.0, features=FEATURES, setup={"robot": "fr3"}, instruction="pick")
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for number in range(episodes):
            numbers = 0.01 * np.cumsum(rng.normal(size=(20, 7)), axis=0)
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(20):
                    row = {FEATURES[0].key: numbers[i], "terminated": i == 19, "time/monotonic": i / 30}
                    episode.add(row if i == 0 else {**row, FEATURES[1].key: numbers[i], "reward": np.float64(i)})
                episode.finish(number % 2 == 0)


def record_long(path: Path, gigabytes: float) -> None:
    """Record one episode of large noisy images."""
    image = Feature(key=RGB, shape=(720, 1280, 3), dtype="uint8", encoding="jpeg")
    info = DatasetInfo(frequency=30.0, features=(*FEATURES, image), setup={}, instruction="pick")
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (720, 1280, 3), np.uint8) for _ in range(4)]
    size = 0.0
    with DatasetWriter.open(path, info) as writer, writer.episode("long", seed=0) as episode:
        i = 0
        while size < gigabytes * 1e9:
            frames[i % 4][0, :8] = i % 256  # no image equals another one
            row = {FEATURES[0].key: np.zeros(7), "terminated": False, "time/monotonic": i / 30, RGB: frames[i % 4]}
            episode.add(row if i == 0 else {**row, FEATURES[1].key: np.zeros(7), "reward": np.float64(i)})
            size += 1.73e6
            i += 1
        episode.finish(True)


if __name__ == "__main__":
    main(tyro.cli(Options))
