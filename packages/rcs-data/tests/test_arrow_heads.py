"""What a file claims in the heads of its batches is not believed: no reading of it takes more memory than the file."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest
from rcs_data.errors import CorruptEpisode
from rcs_data.frames_file import FramesFile

SCHEMA = pa.schema([pa.field("image", pa.large_binary())])


def write(path: Path, images: list[bytes], **options: str) -> Path:
    with pa.ipc.new_file(path, SCHEMA, options=pa.ipc.IpcWriteOptions(**options)) as writer:
        for start in range(0, len(images), 32):
            writer.write_batch(
                pa.record_batch([pa.array(images[start : start + 32], pa.large_binary())], schema=SCHEMA)
            )
    return path


def test_images_are_found_in_every_batch(tmp_path: Path) -> None:
    images = [bytes([i]) * (i + 1) for i in range(100)]
    file = FramesFile(write(tmp_path / "frames.arrow", images))
    assert [file.image(i) for i in range(100)] == images


@pytest.mark.parametrize("mapped", [True, False])
@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_a_compressed_batch_is_refused_before_it_is_read(tmp_path: Path, codec: str, mapped: bool) -> None:
    path = write(tmp_path / "frames.arrow", [bytes(100_000)] * 40, compression=codec)
    file = FramesFile(path, mapped=mapped)
    with pytest.raises(CorruptEpisode, match="batch 1 is compressed"):
        file.image(35)


def test_any_changed_byte_of_the_footer_is_read_or_refused(tmp_path: Path) -> None:
    images = [bytes([i]) * 50 for i in range(70)]
    path = write(tmp_path / "frames.arrow", images)
    data = path.read_bytes()
    for place in range(len(data) - 10 - int.from_bytes(data[-10:-6], "little"), len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            file = FramesFile(path, mapped=False)
            for number in (0, 33, 69):
                file.image(number)
        except CorruptEpisode:
            continue
