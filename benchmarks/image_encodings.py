"""Measure the encodings of colour: bytes, quality, and time on one core to record, finish and read an image.

The images are collected here, without loss: scripted episodes of PickCuboid with two cameras. Each camera of each
episode is then recorded as an episode in every encoding. Times are of the processor; those of reading are the best of
three rounds.

Prints a JSON object per size and kind of sensor; of each encoding `kb`, `psnr_db` (mean over all pixels),
`worst_block_db` (of 16 x 16 pixels), `record_ms`, `finish_ms`, `read_ms` (in order) and `alone_ms` (in random order).
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, FrameAccess
from rcs_data.files.feature import Colour

import rcs
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress

KEY = "observation/frames/camera/rgb"
MODES = ("224x224", "640x480")
BLOCK = 16
Takes = list[list[NDArray[np.uint8]]]


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    episodes: int = 2
    """Episodes to collect of each size and kind of sensor."""
    rounds: int = 3
    """Rounds of reading; the best counts."""


def main(options: Options) -> None:
    """Measure and print."""
    for mode in MODES:
        for noise in (False, True):
            takes = collected(mode, noise=noise, episodes=options.episodes)
            result: dict[str, Any] = {"benchmark": "image_encodings", "size": mode, "noise": noise}
            result["images"] = sum(map(len, takes))
            for colour in get_args(Colour):
                with tempfile.TemporaryDirectory() as folder:
                    result[colour] = measured(Path(folder) / "set", takes, colour, options.rounds)
            print(json.dumps(result), flush=True)


def collected(mode: str, *, noise: bool, episodes: int) -> Takes:
    """Return the images of each camera of each episode."""
    width, height = map(int, mode.split("x"))
    setup = rcs.Setup(
        task="PickCuboid",
        robot="fr3",
        cameras=rcs.Cameras(names=("wrist", "side"), image_size=(width, height), noise=noise),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "set"
        for _ in collect(Collection(setup=setup, out=path, episodes=episodes, seed=1, colour="lossless"), Progress()):
            pass
        dataset = Dataset.open(path)
        keys = [feature.key for feature in dataset.info.features if feature.colour is not None]
        return [list(episode.frames(key)) for episode in dataset for key in keys]


def measured(path: Path, takes: Takes, colour: Colour, rounds: int) -> dict[str, float | None]:
    """Record all images in an encoding, read them, and return the figures."""
    feature = Feature(key=KEY, shape=takes[0][0].shape, dtype="uint8", encoding=colour)
    info = DatasetInfo(frequency=30.0, features=(feature,), setup={}, instruction="")
    record = finish = 0.0
    with DatasetWriter.open(path, info) as writer:
        for number, take in enumerate(takes):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                begin = time.process_time()
                for image in take:
                    episode.add({KEY: image})
                between = time.process_time()
                episode.finish(None)
                record, finish = record + between - begin, finish + time.process_time() - between
    episodes = Dataset.open(path).episodes
    access, rng = FrameAccess(), np.random.default_rng(0)
    places = [(episode, row) for episode in episodes for row in range(episode.length)]
    reading, alone = [], []
    for _ in range(rounds):
        begin = time.process_time()
        for episode in episodes:
            for _ in episode.frames(KEY):
                pass
        reading.append(time.process_time() - begin)
        begin = time.process_time()
        for n in rng.permutation(len(places)).tolist():
            access.frame(places[n][0], KEY, places[n][1])
        alone.append(time.process_time() - begin)
    pairs = (pair for e, take in zip(episodes, takes, strict=True) for pair in zip(e.frames(KEY), take, strict=True))
    errors = np.array(list(block_errors(pairs)))
    count = len(places)
    times = {"record": record, "finish": finish, "read": min(reading), "alone": min(alone)}
    return {
        "kb": round(sum((e.path / "frames.zip").stat().st_size for e in episodes) / count / 1e3, 2),
        "psnr_db": decibel(errors[:, 0].mean()),
        "worst_block_db": decibel(errors[:, 1].max()),
        **{f"{name}_ms": round(1e3 * seconds / count, 2) for name, seconds in times.items()},
    }


def block_errors(pairs: Iterator[tuple[NDArray[Any], NDArray[Any]]]) -> Iterator[tuple[float, float]]:
    """Yield the mean squared error of each image and that of its worst block."""
    for one, other in pairs:
        squares = np.square(one.astype(np.float32) - other).mean(axis=-1)
        rows, columns = (size // BLOCK for size in squares.shape)
        blocks = squares.reshape(rows, BLOCK, columns, BLOCK).mean(axis=(1, 3))
        yield float(blocks.mean()), float(blocks.max())


def decibel(error: float) -> float | None:
    """Return the peak signal-to-noise ratio of a mean squared error; None without an error."""
    return round(float(10 * np.log10(255**2 / error)), 1) if error else None


if __name__ == "__main__":
    main(tyro.cli(Options))
