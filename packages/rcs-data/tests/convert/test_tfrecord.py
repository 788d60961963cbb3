from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rcs_data.convert import tfrecord
from rcs_data.convert.tfrecord import ShardWriter, encode_example, frame
from rcs_data.errors import InvalidSetup

ReadRecords = Callable[[Path], list[bytes]]
ParseExample = Callable[[bytes], dict[str, Any]]


def test_a_record_is_the_one_that_tensorflow_writes() -> None:
    # As tf.io.TFRecordWriter of TensorFlow 2.21 wrote it.
    assert frame(b"abc").hex() == "0300000000000000b099490e" + "616263" + "6e57f121"


def test_an_example_is_the_one_that_tensorflow_serialises() -> None:
    data = encode_example({"c": [b"x", b""], "b": np.array([0.5], np.float32), "a": np.array([1, -1, 300])})
    # As TensorFlow 2.21 serialises it with deterministic=True.
    assert data.hex() == (
        "0a350a160a016112111a0f0a0d01ffffffffffffffffff01ac020a0d0a0162120812060a040000003f0a0c0a016312070a050a01780a00"
    )


def test_what_was_written_is_read_back(tmp_path: Path, read_records: ReadRecords) -> None:
    data = [b"", b"a", np.random.default_rng(0).bytes(100_000)]
    shards = ShardWriter(tmp_path, "name-train.tfrecord", 10**9)
    for record in data:
        shards.write(record)
    shards.close()
    assert [path.name for path in tmp_path.iterdir()] == ["name-train.tfrecord-00000-of-00001"]
    assert read_records(tmp_path / "name-train.tfrecord-00000-of-00001") == data


def test_a_file_that_would_grow_too_long_is_followed_by_another(tmp_path: Path, read_records: ReadRecords) -> None:
    shards = ShardWriter(tmp_path, "s", 250)
    for i in range(7):
        shards.write(bytes([i]) * 100)
    shards.write(bytes(1000))  # longer than a file may be, so it has one of its own
    shards.close()
    files = sorted(tmp_path.iterdir())
    assert [path.name for path in files] == [f"s-{i:05d}-of-00005" for i in range(5)]
    assert [len(read_records(path)) for path in files] == shards.shard_lengths == [2, 2, 2, 1, 1]
    assert sum(path.stat().st_size for path in files) - 16 * 8 == shards.data_bytes == 1700


int64 = st.integers(-(2**63), 2**63 - 1)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # the fixture is a plain function
@given(
    words=st.dictionaries(st.text(max_size=5), st.lists(st.binary(max_size=200), max_size=4), max_size=3),
    integers=st.lists(int64, max_size=20),
    floats=st.lists(st.floats(width=32, allow_nan=False), max_size=20),
)
def test_an_example_says_what_it_was_given(parse_example: ParseExample, words: Any, integers: Any, floats: Any) -> None:
    values = {f"b{name}": given for name, given in words.items()}
    numbers = {"i": np.array(integers, np.int64), "f": np.array(floats, np.float32)}
    found = parse_example(encode_example({**values, **numbers}))
    assert list(found) == sorted([*values, "i", "f"])
    np.testing.assert_array_equal(found.pop("f"), numbers["f"])
    assert found == {**values, "i": integers}


def test_arrays_are_taken_row_by_row(parse_example: ParseExample) -> None:
    values = np.arange(6, dtype=np.float32).reshape(3, 2)
    data = encode_example({"row": values, "column": values.T, "int": np.array([[1, -1], [300, 0]])})
    found = parse_example(data)
    assert found["row"].tolist() == [0, 1, 2, 3, 4, 5]
    assert found["column"].tolist() == [0, 2, 4, 1, 3, 5]
    assert found["int"] == [1, -1, 300, 0]


def test_what_tensorflow_could_not_read_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tfrecord, "_MESSAGE_BYTES", 100)
    encode_example({"a": [bytes(50)]})
    with pytest.raises(InvalidSetup, match="2 GiB"):
        encode_example({"a": [bytes(101)]})
