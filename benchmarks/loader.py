"""Compare the samples per second of random access to a dataset with the rate of decoding alone.

The dataset is collected here: scripted episodes with two cameras of 224 x 224 pixels. A sample is a window of one
observation with both images and of 16 actions; a batch has 64. Every image of a first pass is compared with the one
that is read in order. The reference decodes the same JPEGs, held in memory, in random order and in as many processes,
in rounds that alternate with the loader's; so the rest is what finding, reading and batching cost.

Prints one JSON object: `samples_per_second`, `decode_efficiency` (the share of the reference's rate) and
`cpu_efficiency` (the share of the processor time that decoding takes, which other programs disturb less), by the number
of workers of a `torch.utils.data.DataLoader`, 0 for none; without torch, of batches as NumPy arrays alone.
"""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import Dataset, Windows
from rcs_data.files.codec import decode_frame
from rcs_data.read.torch import TorchDataset

import rcs
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    episodes: int = 16
    """Episodes to collect."""
    size: int = 224
    """Edge length of the images [px]."""
    batch: int = 64
    """Samples in a batch."""
    workers: tuple[int, ...] = (0, 1, 2)
    """Workers of the loader; each number is measured."""
    rounds: int = 5
    """Rounds; the median counts."""
    dataset: Path | None = None
    """A dataset to use instead."""


def main(options: Options) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        path = options.dataset or collected(Path(folder) / "dataset", options.episodes, size=options.size)
        windows = Windows(Dataset.open(path), horizon=16)
        check(windows)
        result: dict[str, Any] = {"benchmark": "loader", "windows": len(windows), "cameras": len(windows.cameras)}
        result |= measure(windows, options)
    print(json.dumps(result))


def collected(path: Path, episodes: int, *, size: int = 224, workers: int = 1) -> Path:
    """Collect a dataset of PickCuboid with two cameras."""
    cameras = rcs.Cameras(names=("wrist", "side"), image_size=(size, size))
    setup = rcs.Setup(task="PickCuboid", robot="fr3", cameras=cameras)
    for _ in collect(Collection(setup=setup, out=path, episodes=episodes, seed=1, workers=workers), Progress()):
        pass
    return path


def check(windows: Windows) -> None:
    """Read everything once, as a first epoch would, and compare each image with the one that is read in order."""
    order = np.random.default_rng(0).permutation(len(windows)).tolist()
    read = {name: dict[tuple[str, int], int]() for name in windows.cameras}
    for begin in range(0, len(order), 64):
        batch = windows.batch(order[begin : begin + 64])
        for name, images in batch["images"].items():
            places = zip(batch["episode"], batch["step"].tolist(), strict=True)
            read[name] |= {place: hash(image.tobytes()) for place, image in zip(places, images[:, -1], strict=True)}
    for name, feature in windows.cameras.items():
        for episode in windows.episodes:
            for row, image in enumerate(list(episode.frames(feature.key))[:-1]):
                assert read[name][episode.id, row] == hash(image.tobytes()), f"{episode.id}, {name}, {row} differ"


def measure(windows: Windows, options: Options) -> dict[str, Any]:
    """Return the rates of the loader and their share of the rate of decoding, by the number of workers."""
    has_torch = importlib.util.find_spec("torch") is not None
    jpegs = [
        (feature, data)
        for feature in windows.cameras.values()
        for episode in windows.episodes
        for data in episode.encoded_frames(feature.key)
    ]
    result: dict[str, Any] = {"loader": "torch DataLoader" if has_torch else "numpy batches; torch is not installed"}
    result |= {"samples_per_second": {}, "decode_efficiency": {}, "cpu_efficiency": {}}
    for workers in options.workers if has_torch else (0,):
        epoch = torch_epoch(windows, workers, options) if has_torch else numpy_epoch(windows, options)
        epoch()  # workers start and find out where images are
        rates, shares, cpu_shares = [], [], []
        for _ in range(options.rounds):
            decoded, alone = decoding(jpegs, max(workers, 1))
            spent, begin = cpu_seconds(), time.perf_counter()
            samples = epoch()
            seconds, spent = time.perf_counter() - begin, cpu_seconds() - spent
            images = samples * len(windows.cameras)
            rates.append(samples / seconds)
            shares.append(images / seconds / decoded)
            cpu_shares.append(alone * images / spent)
        result["samples_per_second"][workers] = round(median(rates), 1)
        result["decode_efficiency"][workers] = round(median(shares), 3)
        result["cpu_efficiency"][workers] = round(median(cpu_shares), 3)
        del epoch  # and with it the workers
    return result


def cpu_seconds() -> float:
    """Return the processor time of this process and the workers that it has."""
    ticks = 0
    for process in multiprocessing.active_children():
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")


def torch_epoch(windows: Windows, workers: int, options: Options) -> Callable[[], int]:
    """Return a function that goes through all samples once and returns their number."""
    from torch.utils.data import DataLoader  # pyright: ignore[reportMissingImports]

    loader: Any = DataLoader(
        TorchDataset(windows),
        batch_size=options.batch,
        shuffle=True,
        num_workers=workers,
        persistent_workers=workers > 0,
    )
    return lambda: sum(len(batch["step"]) for batch in loader)


def numpy_epoch(windows: Windows, options: Options) -> Callable[[], int]:
    """Return the same without torch."""
    rng = np.random.default_rng(0)
    return lambda: sum(len(windows.batch(part)["step"]) for part in batches(rng.permutation(len(windows)), options))


def batches(order: NDArray[np.int64], options: Options) -> Iterator[list[int]]:
    """Cut an order into batches."""
    for begin in range(0, len(order), options.batch):
        yield order[begin : begin + options.batch].tolist()


def decoding(jpegs: list[tuple[Any, bytes]], processes: int) -> tuple[float, float]:
    """Decode all images in random order in each of so many processes.

    Returns:
        Images per second of all together, and processor time for an image [s].
    """
    context = multiprocessing.get_context("fork")
    barrier, answers = context.Barrier(processes), context.SimpleQueue()
    running = [context.Process(target=decode_all, args=(jpegs, barrier, answers)) for _ in range(processes)]
    for process in running:
        process.start()
    walls, cpus = zip(*(answers.get() for _ in running), strict=True)
    for process in running:
        process.join()
    return processes * len(jpegs) / max(walls), sum(cpus) / (processes * len(jpegs))


def decode_all(jpegs: list[tuple[Any, bytes]], barrier: Barrier, answers: SimpleQueue[tuple[float, float]]) -> None:
    """Decode all images and answer how many seconds and how much processor time that took [s]."""
    order = np.random.default_rng(0).permutation(len(jpegs))
    barrier.wait()
    begin, spent = time.perf_counter(), time.process_time()
    for i in order:
        feature, data = jpegs[i]
        decode_frame(feature, data)
    answers.put((time.perf_counter() - begin, time.process_time() - spent))


if __name__ == "__main__":
    main(tyro.cli(Options))
