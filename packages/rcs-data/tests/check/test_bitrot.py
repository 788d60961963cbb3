"""One byte that changed is put back, wherever it is; and what a hash does not confirm is never taken for right."""

from __future__ import annotations

import hashlib
import random
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset
from rcs_data.check.bitrot import mended_json, mended_parquet
from rcs_data.durable import sealed, unsealed


@pytest.fixture
def file(tmp_path: Path) -> bytes:
    """A Parquet file of two row groups with pages that are compressed and pages that are not."""
    rng = np.random.default_rng(0)
    images = pa.array([rng.bytes(400) for _ in range(50)], pa.binary())
    lists = pa.FixedSizeListArray.from_arrays(pa.array(rng.normal(size=350)), 7)
    table = pa.table({"images": images, "lists": lists, "flags": pa.array(rng.random(50) < 0.5)})
    pq.write_table(
        table,
        tmp_path / "file",
        row_group_size=30,
        use_dictionary=False,
        write_statistics=False,
        write_page_checksum=True,
        compression={"images": "none", "lists.list.element": "zstd", "flags": "zstd"},
    )
    return (tmp_path / "file").read_bytes()


def flipped(data: bytes, place: int, bits: int) -> bytes:
    return data[:place] + bytes([data[place] ^ bits]) + data[place + 1 :]


def test_any_changed_bit_of_a_parquet_file_is_put_back(file: bytes) -> None:
    right = hashlib.sha256(file).hexdigest()
    footer = len(file) - 8 - int.from_bytes(file[-8:-4], "little")
    rng = random.Random(0)
    places = {*range(12), *range(len(file) - 12, len(file)), *rng.sample(range(footer), 60)}
    places |= set(rng.sample(range(footer, len(file)), 40))
    for place in places:
        assert mended_parquet(flipped(file, place, 1 << rng.randrange(8)), right) == file, place


def test_any_changed_byte_of_a_page_is_put_back(file: bytes) -> None:
    right = hashlib.sha256(file).hexdigest()
    for place in range(100, 10_000, 301):  # in the first page of images
        assert mended_parquet(flipped(file, place, 0xFF), right) == file, place


def test_what_is_past_one_byte_is_not_guessed(file: bytes) -> None:
    right = hashlib.sha256(file).hexdigest()
    for first, second in ((200, 201), (200, 9000), (200, len(file) - 30)):
        assert mended_parquet(flipped(flipped(file, first, 1), second, 8), right) is None
    for rubbish in (b"", b"PAR1", bytes(100), file[:-1], b"\xff" * 5000):
        assert mended_parquet(rubbish, right) is None


def test_a_changed_bit_of_a_large_page_is_put_back(tmp_path: Path) -> None:
    table = pa.table({"images": pa.array([np.random.default_rng(0).bytes(2 << 20)], pa.binary())})
    pq.write_table(table, tmp_path / "large", compression="none", use_dictionary=False, write_page_checksum=True)
    data = (tmp_path / "large").read_bytes()
    assert mended_parquet(flipped(data, 1000, 4), hashlib.sha256(data).hexdigest()) == data


def test_any_changed_bit_of_a_description_is_put_back(dataset: Path) -> None:
    path = Dataset.open(dataset).episodes[0].path / "episode.json"
    data = path.read_bytes()
    rng = random.Random(1)
    for place in rng.sample(range(len(data)), 8):
        broken = flipped(data, place, 1 << rng.randrange(8))
        try:
            values = unsealed(broken, path)
        except ValueError:
            values = mended_json(broken, path)
        assert values == unsealed(data, path), place


def test_a_description_without_its_checksum_is_not_guessed(tmp_path: Path) -> None:
    data = sealed({"success": True, "seed": 4})
    assert mended_json(data[:-30], tmp_path) is None
    assert mended_json(data.replace(b"true", b"null").replace(b"4", b"5", 1), tmp_path) is None
    assert mended_json(bytes(1 << 20), tmp_path) is None
