"""A stream is readable up to its last whole batch, wherever it was cut."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pyarrow as pa
import pytest
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.stream import EpisodeHeader, StreamReader, StreamWriter

HEADER = EpisodeHeader(id="a", seed=3, instruction="pick", started="2030-01-01T00:00:00+00:00", versions={"rcs": "0"})
SCHEMA = pa.schema([("number", pa.int64()), ("bytes", pa.binary())])


def batch(first: int) -> pa.RecordBatch:
    numbers = pa.array([first, first + 1])
    return pa.RecordBatch.from_arrays([numbers, pa.array([b"x" * 40, b"y"])], schema=SCHEMA)


def write(path: Path, batches: int) -> list[int]:
    """Write a stream; return its size after the head and after each batch."""
    writer = StreamWriter(path, SCHEMA, HEADER)
    sizes = [path.stat().st_size]
    for i in range(batches):
        writer.write(batch(2 * i))
        sizes.append(path.stat().st_size)
    writer.close()
    writer.close()
    return sizes


def numbers(reader: StreamReader) -> list[int]:
    return [n for b in reader.batches() for n in b.column(0).to_pylist()]


def test_what_was_written_is_read(tmp_path: Path) -> None:
    write(tmp_path / "rows", 4)
    reader = StreamReader(tmp_path / "rows")
    assert reader.header == HEADER
    assert reader.schema == SCHEMA
    assert numbers(reader) == list(range(8))
    assert not reader.is_torn


def test_a_stream_cut_at_any_byte_has_all_batches_before_the_cut(tmp_path: Path) -> None:
    sizes = write(tmp_path / "rows", 3)
    data = (tmp_path / "rows").read_bytes()
    for cut in range(len(data) + 1):
        (tmp_path / "cut").write_bytes(data[:cut])
        reader = StreamReader(tmp_path / "cut")
        whole = sum(size <= cut for size in sizes) - 1
        assert numbers(reader) == list(range(2 * max(whole, 0)))
        assert (reader.header == HEADER) is (whole >= 0)
        assert reader.is_torn is (cut not in (0, *sizes))


def test_a_stream_with_a_changed_bit_is_refused_wherever_that_is(tmp_path: Path) -> None:
    write(tmp_path / "rows", 2)
    data = (tmp_path / "rows").read_bytes()
    last = len(data) - struct.unpack("<2I", (tmp_path / "rows.crc").read_bytes()[-8:])[0]
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1 << place % 8
        (tmp_path / "rows").write_bytes(changed)
        if place < last:
            with pytest.raises(CorruptEpisode, match="is not what was written"):
                numbers(StreamReader(tmp_path / "rows"))
        else:  # cut off, as one that a loss of power has left
            reader = StreamReader(tmp_path / "rows")
            assert numbers(reader) == [0, 1]
            assert reader.is_torn


def test_a_batch_that_a_kill_left_without_its_checksum_is_read(tmp_path: Path) -> None:
    write(tmp_path / "rows", 3)
    checksums = tmp_path / "rows.crc"
    checksums.write_bytes(checksums.read_bytes()[:-3])
    reader = StreamReader(tmp_path / "rows")
    assert numbers(reader) == list(range(6))
    assert not reader.is_torn


@pytest.mark.parametrize("byte", [b"\x00", b"\xff"])
def test_rubbish_after_the_last_batch_is_cut(tmp_path: Path, byte: bytes) -> None:
    write(tmp_path / "rows", 2)
    with (tmp_path / "rows").open("ab") as file:
        file.write(byte * 300)
    reader = StreamReader(tmp_path / "rows")
    assert numbers(reader) == [0, 1, 2, 3]
    assert reader.is_torn


def test_a_full_disk_leaves_whole_batches_and_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = StreamWriter(tmp_path / "rows", SCHEMA, HEADER)
    writer.write(batch(0))
    write_for_real = os.write

    def write_a_little(fd: int, data: memoryview) -> int:
        if len(data) < 100:
            raise OSError(28, "No space left on device")
        return write_for_real(fd, data[:100])

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", write_a_little)
        with pytest.raises(DatasetError, match=r"record rows in .*rows: No space left on device\. Free some space"):
            writer.write(batch(2))
    writer.close()
    reader = StreamReader(tmp_path / "rows")
    assert numbers(reader) == [0, 1]
    assert not reader.is_torn
