from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data.convert.rlds import tfrecord
from rcs_data.convert.rlds.tfrecord import ShardWriter, read_examples
from rcs_data.errors import CorruptEpisode, InvalidSetup
from tfrecord.writer import TFRecordWriter

ReadRecords = Callable[[Path], list[bytes]]
ParseExample = Callable[[bytes], dict[str, Any]]


def test_a_file_is_the_one_that_tensorflow_writes(tmp_path: Path) -> None:
    data = _written(tmp_path, {"c": [b"x", b""], "b": np.array([0.5], np.float32), "a": np.array([1, -1, 300])})
    # As TensorFlow 2.21 serialises the Example with deterministic=True.
    assert data[12:-4].hex() == (
        "0a350a160a016112111a0f0a0d01ffffffffffffffffff01ac020a0d0a0162120812060a040000003f0a0c0a016312070a050a01780a00"
    )


def test_a_file_that_would_grow_too_long_is_followed_by_another(tmp_path: Path, read_records: ReadRecords) -> None:
    shards = ShardWriter(tmp_path, "s", 250)
    for i in range(7):
        shards.write({"a": [bytes([i]) * 86]})
    shards.write({"a": [bytes(1000)]})  # longer than a file may be, so it has one of its own
    shards.close()
    files = sorted(tmp_path.iterdir())
    assert [path.name for path in files] == [f"s-{i:05d}-of-00005" for i in range(5)]
    assert [len(read_records(path)) for path in files] == shards.shard_lengths == [2, 2, 2, 1, 1]
    assert sum(path.stat().st_size for path in files) - 16 * 8 == shards.data_bytes


def test_an_example_is_read_as_it_was_given(tmp_path: Path) -> None:
    values = {"words": [b"x", b"", bytes(200)], "i": np.array([-(2**63), 2**63 - 1]), "f": np.array([0.5], np.float32)}
    _written(tmp_path, {**values, "none": []})
    (example,) = read_examples(tmp_path / "s-00000-of-00001")
    assert sorted(example) == ["f", "i", "none", "words"]
    assert (example["words"], example["none"]) == (values["words"], [])
    for name in ("i", "f"):
        np.testing.assert_array_equal(example[name], values[name])


def test_arrays_are_taken_row_by_row(tmp_path: Path, parse_example: ParseExample) -> None:
    values = np.arange(6, dtype=np.float32).reshape(3, 2)
    data = _written(tmp_path, {"row": values, "column": values.T, "int": np.array([[1, -1], [300, 0]])})
    found = parse_example(data[12:-4])
    assert found["row"].tolist() == [0, 1, 2, 3, 4, 5]
    assert found["column"].tolist() == [0, 2, 4, 1, 3, 5]
    assert found["int"] == [1, -1, 300, 0]


def test_what_tensorflow_could_not_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tfrecord, "_MESSAGE_BYTES", 100)
    _written(tmp_path, {"a": [bytes(50)]})
    with pytest.raises(InvalidSetup, match="2 GiB"):
        _written(tmp_path, {"a": [bytes(101)]})


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "no whole record"),
        (lambda data: data[:5], "no whole record"),
        (lambda data: b"", "empty"),
        (lambda data: b"\xff" * 7 + data[7:], "no whole record"),
        (lambda data: data[:20] + b"?" + data[21:], "not what was written"),
    ],
)
def test_files_that_are_damaged_are_refused(tmp_path: Path, damage: Any, message: str) -> None:
    data = _written(tmp_path, {"a": [bytes(50)]})
    (tmp_path / "file").write_bytes(damage(data))
    with pytest.raises(CorruptEpisode, match=message):
        list(read_examples(tmp_path / "file"))


def test_a_record_that_is_no_example_is_refused(tmp_path: Path) -> None:
    size, data = (6).to_bytes(8, "little"), b"\x0a" + b"\xff" * 5
    checksum = TFRecordWriter.masked_crc
    (tmp_path / "file").write_bytes(size + checksum(size) + data + checksum(data))
    with pytest.raises(CorruptEpisode, match="no Example"):
        list(read_examples(tmp_path / "file"))


def _written(folder: Path, features: Any) -> bytes:
    shards = ShardWriter(folder, "s", 10**9)
    shards.write(features)
    shards.close()
    return (folder / "s-00000-of-00001").read_bytes()
