"""A dataset with all that an export may meet, made without a simulation; and a reader of TFRecord files."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from tfrecord import example_pb2
from tfrecord.reader import tfrecord_iterator
from tfrecord.writer import TFRecordWriter

Example = dict[str, Any]
MakeDataset = Callable[..., Dataset]

HEIGHT, WIDTH = 32, 48
WORDS = ("pick up the green cuboid", "nimm den grünen Würfel – 拿起方块")


@pytest.fixture
def make_dataset(tmp_path: Path) -> MakeDataset:
    """Make a dataset of several episodes; see `_made` for what can be chosen."""

    def make(name: str = "source", **choices: Any) -> Dataset:
        return _made(tmp_path / name, **choices)

    return make


@pytest.fixture
def source(make_dataset: MakeDataset) -> Dataset:
    """Three episodes of 7, 8 and 9 rows: one arm, two cameras, depth, matrices, times, two instructions."""
    return make_dataset()


@pytest.fixture
def read_records() -> Callable[[Path], list[bytes]]:
    return _records


@pytest.fixture
def parse_example() -> Callable[[bytes], Example]:
    return _example


def _records(path: Path) -> list[bytes]:
    """Return the records of a file, by the package's own reader, with their checksums compared."""
    data, at, records = path.read_bytes(), 0, list[bytes]()
    for record in tfrecord_iterator(str(path)):
        records.append(bytes(record))
        size = struct.pack("<Q", len(record))
        assert data[at : at + 12] == size + TFRecordWriter.masked_crc(size)
        at += 12 + len(record)
        assert data[at : at + 4] == TFRecordWriter.masked_crc(records[-1])
        at += 4
    return records


def _example(data: bytes) -> Example:
    values: Example = {}
    for name, feature in example_pb2.Example.FromString(data).features.feature.items():
        kind = feature.WhichOneof("kind")
        values[name] = list(getattr(feature, kind).value)
        values[name] = np.array(values[name], np.float32) if kind == "float_list" else values[name]
    return values


def _made(
    path: Path,
    *,
    episodes: int = 3,
    cameras: bool = True,
    robots: tuple[str, ...] = ("",),
    frequency: float = 30.0,
    success: tuple[bool | None, ...] = (True, False, True),
    **changes: Any,
) -> Dataset:
    features = list(_features(cameras, robots))
    values = {"frequency": frequency, "setup": {"robot": "fr3"}, "instruction": WORDS[0], "features": tuple(features)}
    with DatasetWriter.open(path, DatasetInfo(**{**values, **changes})) as writer:
        for index in range(episodes):
            words = WORDS[index % len(WORDS)]
            with writer.episode(f"take-{index}", seed=100 + index, instruction=words) as episode:
                for row in _rows(7 + index, features, index):
                    episode.add(row)
                verdict = success[index % len(success)]
                episode.finish(verdict, {"failure": None if verdict else "slip"})
    return Dataset.open(path)


def _features(cameras: bool, robots: tuple[str, ...]) -> Iterator[Feature]:
    for robot in robots:
        part = f"{robot}/" if robot else ""
        yield Feature(key=f"observation/{part}gripper", shape=(1,), dtype="float32")
        yield Feature(key=f"observation/{part}joints", shape=(3,), dtype="float64", unit="rad")
        yield Feature(key=f"observation/{part}xyzrpy", shape=(6,), dtype="float64")
        yield Feature(key=f"action/{part}gripper", shape=(1,), dtype="float32")
        yield Feature(key=f"action/{part}joints", shape=(3,), dtype="float64", unit="rad")
        yield Feature(key=f"executed/{part}joints", shape=(3,), dtype="float64", unit="rad")
    yield Feature(key="reward", shape=(), dtype="float64")
    yield Feature(key="terminated", shape=(), dtype="bool")
    yield Feature(key="truncated", shape=(), dtype="bool")
    yield Feature(key="time/monotonic", shape=(), dtype="float64", unit="s")
    yield Feature(key="time/period", shape=(), dtype="float64", unit="s")
    if cameras:
        for name in ("side", "wrist"):
            stem = f"observation/frames/{name}"
            yield Feature(key=f"{stem}/extrinsics", shape=(4, 4), dtype="float64")
            yield Feature(key=f"{stem}/intrinsics", shape=(3, 3), dtype="float64", unit="px")
            yield Feature(key=f"{stem}/rgb", shape=(HEIGHT, WIDTH, 3), dtype="uint8", encoding="jpeg")
        yield Feature(key="observation/frames/side/depth", shape=(12, 16), dtype="uint16", encoding="depth")


def _rows(length: int, features: list[Feature], seed: int) -> Iterator[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    for i in range(length):
        row: dict[str, Any] = {}
        for feature in features:
            key = feature.key
            if i == 0 and feature.is_unknown_at_reset:
                continue
            if feature.encoding == "jpeg":
                row[key] = _picture(seed, i)
            elif feature.encoding == "depth":
                row[key] = rng.integers(0, 65536, feature.shape, np.uint16)
            elif key.endswith("trinsics"):
                # The camera on the gripper moves; nothing else does.
                row[key] = np.eye(feature.shape[0]) + i * ("wrist/ex" in key)
            elif key == "time/period":
                row[key] = None if i == 0 else 1 / 30 + 0.001 * rng.random()
            elif key == "time/monotonic":
                row[key] = 100 + i / 29
            elif key in ("terminated", "truncated"):
                row[key] = key == "terminated" and i == length - 1 and seed % 2 == 0
            elif feature.shape == ():
                row[key] = rng.normal()
            else:
                row[key] = rng.normal(size=feature.shape).astype(feature.dtype)
        yield row


def _picture(seed: int, row: int) -> NDArray[np.uint8]:
    # Smooth and moving, as codecs are made for.
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    planes = [127 + 100 * np.sin(0.05 * (x + y) + 0.2 * row + seed + phase) for phase in (0, 1, 2)]
    return np.stack(planes, axis=-1).astype(np.uint8)
