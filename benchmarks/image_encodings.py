"""Measure the encodings of colour: bytes, quality, and time on one core to record, finish and read an image.

The images are collected here, without loss: scripted episodes of PickCuboid with two cameras. Each camera of each
episode is then recorded as an episode in every encoding. Times are of the processor; those of reading are the best of
three rounds.

Prints a JSON object per size and kind of sensor; of each encoding `kb`, `psnr_db` (mean over all pixels),
`worst_block_db` (of 16 x 16 pixels), `record_ms`, `finish_ms`, `read_ms` (in order) and `alone_ms` (in random order).
`beside_packages` has what the library writes and reads itself, and what packages take for the same, in turns [ms]: to
write a ZIP of 300 images, to open it and read one of them at random, to write depth as PNG.
"""

from __future__ import annotations

import io
import itertools
import json
import random
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, get_args

import av
import numpy as np
import pyarrow as pa
import simplejpeg
import tyro
from numpy.typing import NDArray
from PIL import Image
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, FrameAccess
from rcs_data.files.codec import encode_png
from rcs_data.files.durable import HashedFile
from rcs_data.files.feature import Colour
from rcs_data.files.frames_file import FramesFile, FramesWriter

import rcs
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress

KEY = "observation/frames/camera/rgb"
MODES = ("224x224", "640x480")
BLOCK = 16
IN_A_FILE, CALLS = 300, 50
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
            takes, depths = collected(mode, noise=noise, episodes=options.episodes)
            result: dict[str, Any] = {"benchmark": "image_encodings", "size": mode, "noise": noise}
            result["images"] = sum(map(len, takes))
            for colour in get_args(Colour):
                with tempfile.TemporaryDirectory() as folder:
                    result[colour] = measured(Path(folder) / "set", takes, colour, options.rounds)
            with tempfile.TemporaryDirectory() as folder:
                result["beside_packages"] = beside_packages(Path(folder), takes, depths, options.rounds)
            print(json.dumps(result), flush=True)


def collected(mode: str, *, noise: bool, episodes: int) -> tuple[Takes, list[NDArray[np.uint16]]]:
    """Return the images of each camera of each episode, and all depth images."""
    width, height = map(int, mode.split("x"))
    setup = rcs.Setup(
        task="PickCuboid",
        robot="fr3",
        cameras=rcs.Cameras(names=("wrist", "side"), image_size=(width, height), noise=noise, depth=True),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "set"
        for _ in collect(Collection(setup=setup, out=path, episodes=episodes, seed=1, colour="lossless"), Progress()):
            pass
        dataset = Dataset.open(path)
        keys = [feature.key for feature in dataset.info.features if feature.colour is not None]
        takes = [list(episode.frames(key)) for episode in dataset for key in keys]
        keys = [feature.key for feature in dataset.info.features if feature.encoding == "depth"]
        return takes, [image for episode in dataset for key in keys for image in episode.frames(key)]


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


def beside_packages(
    folder: Path, takes: Takes, depths: list[NDArray[np.uint16]], rounds: int
) -> dict[str, dict[str, float]]:
    """Return how long our own writers and readers take, and those of packages, in turns; the best round counts [ms]."""
    taken = itertools.islice(itertools.chain(*takes), IN_A_FILE)
    images = [simplejpeg.encode_jpeg(np.ascontiguousarray(image), 95, "RGB", "420") for image in taken]
    rows = pa.table({KEY: pa.array(images, pa.binary())})
    ours, theirs = folder / "ours.zip", folder / "theirs.zip"
    draw, depth = random.Random(0), itertools.cycle(depths)

    def write_ours() -> None:
        with FramesWriter(ours, [KEY]) as frames:
            frames.numbered(rows)
            frames.complete()

    def write_zipfile() -> None:
        file: Any = HashedFile(theirs)
        with zipfile.ZipFile(file, "w") as frames:
            for number, image in enumerate(images):
                frames.writestr(f"{number:08d}.jpg", image)
        file.complete()

    def read_zipfile() -> None:
        with zipfile.ZipFile(theirs) as frames:
            frames.read(draw.choice(frames.infolist()))

    tasks: dict[str, dict[str, Callable[[], object]]] = {
        f"zip, write {len(images)}": {"ours": write_ours, "zipfile": write_zipfile},
        "zip, open and read one": {
            "ours": lambda: FramesFile(ours).image(draw.randrange(len(images))),
            "zipfile": read_zipfile,
        },
        "png, write": {
            "ours": lambda: encode_png(next(depth)),
            "PyAV": lambda: png_by_pyav(next(depth)),
            "Pillow": lambda: Image.fromarray(next(depth)).save(io.BytesIO(), "png", compress_level=1),
        },
    }
    best = {task: dict.fromkeys(ways, np.inf) for task, ways in tasks.items()}
    for _ in range(rounds):
        for task, ways in tasks.items():
            for name, call in ways.items():
                begin = time.process_time()
                for _ in range(CALLS):
                    call()
                best[task][name] = min(best[task][name], round(1e3 * (time.process_time() - begin) / CALLS, 3))
    return best


def png_by_pyav(image: NDArray[np.uint16]) -> bytes:
    """Return depth as FFmpeg's PNG, with the filter "sub" and the fastest level that is not much larger."""
    context: Any = av.CodecContext.create("png", "w")
    context.height, context.width = image.shape
    context.pix_fmt, context.time_base, context.thread_count = "gray16be", Fraction(1), 1
    context.options = {"compression_level": "1", "pred": "sub"}
    (packet,) = context.encode(av.VideoFrame.from_ndarray(image, format="gray16be"))
    return bytes(packet)


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
