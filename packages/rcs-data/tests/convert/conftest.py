"""A dataset with all that an export may meet, made without a simulation; and a reader of TFRecord files.

The reader of TFRecord files and of the Examples in them is written from the specification, not from the writer.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature

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
    data = path.read_bytes()
    records: list[bytes] = []
    while data:
        (length,) = struct.unpack("<Q", data[:8])
        assert _unmasked(data[8:12]) == google_crc32c.value(data[:8])
        record, data = data[12 : 12 + length], data[12 + length :]
        assert len(record) == length and _unmasked(data[:4]) == google_crc32c.value(record)
        records.append(record)
        data = data[4:]
    return records


def _unmasked(data: bytes) -> int:
    rotated = (struct.unpack("<I", data)[0] - 0xA282EAD8) % 2**32
    return ((rotated >> 17) | (rotated << 15)) % 2**32


def _example(data: bytes) -> Example:
    ((_, features),) = _fields(data)
    values: Example = {}
    for _, entry in _fields(features):
        (_, name), (_, feature) = _fields(entry)
        ((kind, items),) = _fields(feature)
        inner = _fields(items)
        if kind == 1:
            values[name.decode()] = [value for _, value in inner]
        elif kind == 2:
            values[name.decode()] = np.frombuffer(b"".join(value for _, value in inner), "<f4")
        else:
            values[name.decode()] = _integers(b"".join(value for _, value in inner))
    return values


def _fields(data: bytes) -> list[tuple[int, bytes]]:
    fields: list[tuple[int, bytes]] = []
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        assert tag & 7 == 2
        length, at = _varint(data, at)
        fields.append((tag >> 3, data[at : at + length]))
        at += length
    assert at == len(data)
    return fields


def _integers(data: bytes) -> list[int]:
    values: list[int] = []
    at = 0
    while at < len(data):
        value, at = _varint(data, at)
        values.append(value - 2**64 if value >= 2**63 else value)
    return values


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


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
