from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rcs_data.convert import tfrecord
from rcs_data.convert.protobuf import FIXED32, field, integers
from rcs_data.convert.tfrecord import ShardWriter, read_examples
from rcs_data.errors import CorruptEpisode, InvalidSetup

ReadRecords = Callable[[Path], list[bytes]]
ParseExample = Callable[[bytes], dict[str, Any]]


def test_a_file_is_the_one_that_tensorflow_writes(tmp_path: Path) -> None:
    data = _written(tmp_path, {"c": [b"x", b""], "b": np.array([0.5], np.float32), "a": np.array([1, -1, 300])})
    # As TensorFlow 2.21 serialises the Example with deterministic=True.
    assert data[12:-4].hex() == (
        "0a350a160a016112111a0f0a0d01ffffffffffffffffff01ac020a0d0a0162120812060a040000003f0a0c0a016312070a050a01780a00"
    )
    # And as tf.io.TFRecordWriter wrote "abc".
    assert google_crc32c.value(b"abc") == 0x364B3FB7
    assert (tfrecord._masked(google_crc32c.value(b"abc"))).hex() == "6e57f121"


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


int64 = st.integers(-(2**63), 2**63 - 1)


# The fixtures are a plain function and a folder that each example writes over.
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    words=st.dictionaries(st.text(max_size=5), st.lists(st.binary(max_size=200), max_size=4), max_size=3),
    integers=st.lists(int64, max_size=20),
    floats=st.lists(st.floats(width=32, allow_nan=False), max_size=20),
)
def test_an_example_says_what_it_was_given(
    tmp_path: Path, parse_example: ParseExample, words: Any, integers: Any, floats: Any
) -> None:
    values = {f"b{name}": given for name, given in words.items()}
    numbers = {"i": np.array(integers, np.int64), "f": np.array(floats, np.float32)}
    data = _written(tmp_path, {**values, **numbers})
    found = parse_example(data[12:-4])
    assert list(found) == sorted([*values, "i", "f"])
    np.testing.assert_array_equal(found.pop("f"), numbers["f"])
    assert found == {**values, "i": integers}
    # And the reader agrees with the one of the tests.
    (example,) = read_examples(tmp_path / "s-00000-of-00001")
    assert {name: list(map(bytes, example[name].strings())) for name in values} == values
    for name, expected in numbers.items():
        np.testing.assert_array_equal(example[name].numbers(20), expected)


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


def test_numbers_that_are_not_packed_are_read(tmp_path: Path) -> None:
    floats = b"".join(field(1, struct.pack("<f", x), FIXED32) for x in (0.5, 2.0))
    whole = b"".join(field(1, x) for x in (3, 300))
    entries = [field(1, name) + field(2, field(kind, data)) for name, kind, data in (("f", 2, floats), ("i", 3, whole))]
    _frame(tmp_path / "file", field(1, b"".join(field(1, entry) for entry in entries)))
    (example,) = read_examples(tmp_path / "file")
    assert example["f"].numbers(2).tolist() == [0.5, 2.0] and example["i"].numbers(2).tolist() == [3, 300]


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


@pytest.mark.parametrize(
    "data",
    [
        b"\x0a\xff\xff\xff\xff\x0f",  # claims 4 GiB
        b"\x0a" + b"\xff" * 20,  # a length that never ends
        b"\x0b",  # a wire type that there is not
        field(1, field(1, field(2, b""))),  # no name
        field(1, field(1, field(1, b"\xff"))),  # a name that is not UTF-8
    ],
)
def test_messages_that_are_none_are_refused(tmp_path: Path, data: bytes) -> None:
    _frame(tmp_path / "file", data)
    with pytest.raises(CorruptEpisode):
        list(read_examples(tmp_path / "file"))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([b"x"], "byte strings; expected numbers"),
        (np.zeros(1000, np.float32), "more than its 3 numbers"),
    ],
)
def test_lists_that_are_not_what_is_expected_are_refused(tmp_path: Path, given: Any, message: str) -> None:
    _written(tmp_path, {"a": given})
    (example,) = read_examples(tmp_path / "s-00000-of-00001")
    with pytest.raises(CorruptEpisode, match=message):
        example["a"].numbers(3)


@pytest.mark.parametrize("data", [b"\x80", b"\x80" * 11 + b"\x01"])
def test_whole_numbers_that_do_not_end_are_refused(data: bytes) -> None:
    with pytest.raises(CorruptEpisode, match="number"):
        integers(data)


def _written(folder: Path, features: Any) -> bytes:
    shards = ShardWriter(folder, "s", 10**9)
    shards.write(features)
    shards.close()
    return (folder / "s-00000-of-00001").read_bytes()


def _frame(path: Path, data: bytes) -> None:
    size = struct.pack("<Q", len(data))
    crcs = [
        struct.pack("<I", ((c >> 15 | c << 17) + 0xA282EAD8) % 2**32) for c in map(google_crc32c.value, (size, data))
    ]
    path.write_bytes(size + crcs[0] + data + crcs[1])
