"""The content hash sees every value and no time, however the rows were cut."""

from __future__ import annotations

import hashlib
import itertools
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.read.content import ContentHash

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

STATE = 5  # the sim_state_size of make_info

FEATURES = (
    Feature(key="observation/joints", shape=(2,), dtype="float64"),
    Feature(key="terminated", shape=(), dtype="bool"),
    Feature(key="observation/frames/wrist/rgb", shape=(8, 8, 3), dtype="uint8", encoding="jpeg"),
    Feature(key="time/monotonic", shape=(), dtype="float64"),
)
INFO = DatasetInfo(frequency=30, features=FEATURES, setup={}, instruction="")


def table(rows: int, seed: int = 0) -> pa.Table:
    rng = np.random.default_rng(seed)
    joints = [None if i % 3 == 0 else rng.normal(size=2).tolist() for i in range(rows)]
    columns = [joints, [i % 2 == 0 for i in range(rows)], [rng.bytes(5) for _ in range(rows)], [0.5] * rows]
    arrays = [pa.array(values, feature.arrow_type) for values, feature in zip(columns, FEATURES, strict=True)]
    return pa.Table.from_arrays(arrays, schema=pa.schema([feature.arrow_field for feature in FEATURES]))


def content(*parts: pa.Table) -> str:
    digest = ContentHash(INFO)
    for part in parts:
        digest.add(part)
    return digest.hexdigest()


@settings(deadline=None)  # the first one loads libraries
@given(st.lists(st.integers(0, 12), max_size=4))
def test_the_hash_does_not_depend_on_how_the_rows_are_cut(cuts: list[int]) -> None:
    rows = table(12)
    edges = [0, *sorted(cuts), 12]
    parts = [rows.slice(a, b - a) for a, b in itertools.pairwise(edges)]
    assert content(*parts) == content(rows)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_the_hash_sees_every_column(column: int) -> None:
    one, other = table(9), table(9, seed=1)
    changed = one.set_column(column, one.schema.field(column), other.column(column).take([*range(8), 7]))
    assert content(changed) != content(one)


def test_times_do_not_count() -> None:
    one = table(5)
    other = one.set_column(3, one.schema.field(3), pa.array(np.arange(5.0)))
    assert content(one) == content(other)


def test_a_value_of_zero_is_not_no_value() -> None:
    one = table(1)
    other = one.set_column(0, one.schema.field(0), pa.array([[0.0, 0.0]], FEATURES[0].arrow_type))
    assert content(one) != content(other)


def test_the_same_rows_make_the_same_bytes(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    rows = make_rows(20, images=True)
    paths: list[Path] = []
    for name, pause in (("one", 1), ("other", 7)):
        with DatasetWriter.open(tmp_path / name, make_info(images=True)) as writer:
            episode = writer.episode("a", seed=0)
            for i, row in enumerate(rows):
                episode.add(row, np.zeros(STATE))
                if i % pause == 0:
                    episode._flush()  # pyright: ignore[reportPrivateUsage]
            paths.append(episode.finish(True).path)
    for file in ("steps.parquet", "frames.zip"):
        assert (paths[0] / file).read_bytes() == (paths[1] / file).read_bytes()


def test_two_runs_alike_but_for_the_time_have_one_hash(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        one = record(writer, "one", length=8)
        with writer.episode("other", seed=0) as episode:
            for i, row in enumerate(make_rows(8)):
                episode.add({**row, "time/monotonic": 7.0 * i}, np.full(STATE, float(i)))
            other = episode.finish(True)
    assert one.content_hash == other.content_hash
    assert one.about["sha256"]["steps.parquet"] != other.about["sha256"]["steps.parquet"]


def test_the_hash_is_what_its_recipe_makes_of_the_values() -> None:
    """So that other programs can compute it."""
    rows, total = table(7), hashlib.sha256()
    for key in sorted(name for name in rows.column_names if not name.startswith("time/")):
        values = rows.column(key).to_pylist()
        if isinstance(values[0], bytes):
            stored = b"".join(struct.pack("<Q", len(image)) + image for image in values)
        elif isinstance(values[1], bool):
            stored = bytes(values)
        else:
            stored = b"".join(struct.pack("<2d", *(pair or (0.0, 0.0))) for pair in values)
        nulls = bytes(value is None for value in values)
        total.update(key.encode() + b"\0" + hashlib.sha256(nulls).digest() + hashlib.sha256(stored).digest())
    assert content(rows) == total.hexdigest()
