"""A small file that claims or holds gigabytes is refused before it is read."""

from __future__ import annotations

import hashlib
import resource
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset, check
from rcs_data.durable import sealed, unsealed
from rcs_data.errors import CorruptEpisode
from rcs_data.parquet import FREE_BYTES, opened

ROWS = 1_000_000


def zeros(rows: int, size: int) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(rows * size)), size)


@pytest.fixture
def bomb(tmp_path: Path) -> Path:
    table = pa.table({"a": zeros(ROWS, 3)})
    with pq.ParquetWriter(tmp_path / "bomb.parquet", table.schema, compression="zstd") as writer:
        for _ in range(8):
            writer.write_table(table)
    return tmp_path / "bomb.parquet"


def test_a_bomb_is_refused_before_it_takes_memory(bomb: Path) -> None:
    assert bomb.stat().st_size < 1 << 20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with opened(bomb) as source, pytest.raises(CorruptEpisode, match="and claims"):
        source.table()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_of_a_bomb_what_is_small_is_read(bomb: Path) -> None:
    with opened(bomb) as source:
        assert source.table(groups=[3]).num_rows == ROWS


def test_one_value_that_stands_for_many_rows_is_refused(tmp_path: Path) -> None:
    table = pa.table({"a": pa.array([bytes(1_000_000)] * 200)})
    pq.write_table(table, tmp_path / "bomb.parquet", compression="zstd", use_dictionary=True)
    with opened(tmp_path / "bomb.parquet") as source, pytest.raises(CorruptEpisode, match="once read"):
        source.table()


def varint(value: int) -> bytes:
    """A whole number from 0 as Thrift writes it."""
    folded, data = 2 * value, b""
    while folded > 0x7F:
        data, folded = data + bytes([folded & 0x7F | 0x80]), folded >> 7
    return data + bytes([folded])


def test_a_footer_that_claims_less_than_its_pages_hold_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"a": np.zeros(1 << 25)}), path, compression="zstd", use_dictionary=False)
    data = bytearray(path.read_bytes())
    column = pq.read_metadata(path).row_group(0).column(0)
    for claimed in (column.total_uncompressed_size, column.num_values):
        said, at = varint(claimed), len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        small = bytes([0x80 | 20, *[0x80] * (len(said) - 2), 0])  # 10, in as many bytes
        data[at:] = data[at:].replace(said, small)
    path.write_bytes(data)
    claims = pq.read_metadata(path).row_group(0)
    assert (claims.num_rows, claims.column(0).total_uncompressed_size) == (10, 10)
    with opened(path) as source, pytest.raises(CorruptEpisode, match="and claims at least"):
        source.table()


def test_rows_without_values_take_memory_too(tmp_path: Path) -> None:
    rows = FREE_BYTES // 24 + 1
    pq.write_table(pa.table({"a": pa.nulls(rows, pa.list_(pa.float64(), 3))}), tmp_path / "bomb.parquet")
    with opened(tmp_path / "bomb.parquet") as source, pytest.raises(CorruptEpisode, match=f"claims {rows} rows"):
        source.table()


def test_older_versions_of_arrow_read_the_same_rows(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise pa.ArrowInvalid("Expected all lists to be of size=3 but index 1 had size=0")

    for episode in Dataset.open(dataset):
        before = episode.numbers()
        with monkeypatch.context() as patch:
            patch.setattr(pq.ParquetFile, "read_row_groups", fails)
            after = episode.numbers()
        assert after.schema.equals(before.schema)
        assert after.equals(before)


def test_check_and_readers_refuse_an_episode_that_is_a_bomb(dataset: Path) -> None:
    folder = dataset / "episodes/000001"
    schema = Dataset.open(dataset).info.steps_schema
    columns = {
        field.name: pa.nulls(ROWS, field.type) if field.name != "observation/joints" else zeros(ROWS, 3)
        for field in schema
    }
    table = pa.table(columns, schema)
    with pq.ParquetWriter(folder / "steps.parquet", schema, compression="zstd") as writer:
        for _ in range(8):
            writer.write_table(table)
    about = unsealed((folder / "episode.json").read_bytes(), folder)
    digest = hashlib.sha256((folder / "steps.parquet").read_bytes()).hexdigest()
    changes = {"length": 8 * ROWS, "sha256": {**about["sha256"], "steps.parquet": digest}}
    (folder / "episode.json").write_bytes(sealed({**about, **changes}))
    with pytest.raises(CorruptEpisode, match=r"000001/steps\.parquet"):
        Dataset.open(dataset)["000001"].column("observation/joints")
    assert "claims" in str(check(dataset).damage[0])
    assert Dataset.open(dataset)["000000"].column("observation/joints").shape == (6, 3)
