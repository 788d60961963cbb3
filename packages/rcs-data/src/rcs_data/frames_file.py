"""`frames.arrow`: all images of an episode in the order of recording, each at once accessible by its number.

An Arrow IPC file with one column, `image`, and 32 images in each batch: image i is row i % 32 of batch i // 32. Mapped
into memory, 28 µs open it and 5 µs find an image, of which nothing else is read.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rcs_data.arrow_heads import BatchHeads
from rcs_data.durable import HashedFile
from rcs_data.errors import CorruptEpisode

IMAGES_IN_A_BATCH = 32
_SCHEMA = pa.schema([pa.field("image", pa.large_binary())])


class FramesWriter:
    """Writes `frames.arrow` from rows with images; hashed on the way, with at most one batch in memory."""

    def __init__(self, path: Path, keys: list[str]) -> None:
        """Start the file, replacing any that is there.

        Args:
            path: The file.
            keys: The columns with images; those of a row are stored in this order.
        """
        self.name = path.name
        self._last = dict.fromkeys(keys, -1)
        self._count = 0
        self._waiting: list[pa.Buffer] = []
        self._file = HashedFile(path)
        self._writer: Any = pa.ipc.new_file(self._file, _SCHEMA)

    def __enter__(self) -> FramesWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._writer.close()  # writes its footer, which a closed file drops

    def numbered(self, rows: pa.Table) -> pa.Table:
        """Store the images of the next rows, and return the rows with the number of each row's image, or -1."""
        columns = [rows.column(key) for key in self._last]
        is_new = np.stack([column.is_valid().to_numpy() for column in columns], axis=1)
        numbers = np.where(is_new, self._count + np.cumsum(is_new.reshape(-1)).reshape(is_new.shape) - 1, -1)
        self._count += int(is_new.sum())
        images = [_images(column) for column in columns]
        for place in np.nonzero(is_new)[1].tolist():
            self._waiting.append(next(images[place]))
            if len(self._waiting) == IMAGES_IN_A_BATCH:
                self._write()
        for (key, last), column in zip(self._last.items(), numbers.T, strict=True):
            shown = np.maximum.accumulate(np.maximum(column, last))
            self._last[key] = int(shown[-1]) if len(shown) else last
            place = rows.schema.get_field_index(key)
            field = rows.schema.field(place).with_type(pa.int32())
            rows = rows.set_column(place, field, pa.array(shown.astype(np.int32)))
        return rows

    def complete(self) -> str:
        """Write what is left, bring the file to the disk and return its SHA-256."""
        self._write()
        self._writer.close()
        return self._file.complete()

    def _write(self) -> None:
        if self._waiting:
            ends = np.cumsum([0, *(image.size for image in self._waiting)], dtype=np.int64)
            data = [None, pa.py_buffer(ends), pa.py_buffer(b"".join(self._waiting))]
            images = pa.LargeBinaryArray.from_buffers(pa.large_binary(), len(self._waiting), data)
            self._waiting.clear()
            self._writer.write_batch(pa.record_batch([images], schema=_SCHEMA))


def _images(column: pa.ChunkedArray) -> Iterator[pa.Buffer]:
    for image in column:
        if image.is_valid:
            yield image.as_buffer()


class FramesFile:
    """An open `frames.arrow`; while it is mapped, an unreadable sector of it ends the process."""

    def __init__(self, path: Path, *, mapped: bool = True) -> None:
        """Open the file.

        Args:
            path: The file.
            mapped: Whether it is mapped into memory instead of read, batch by batch.

        Raises:
            CorruptEpisode: It is missing or not such a file.
        """
        self.path = path
        self._batch: tuple[int, Any] = (-1, None)
        try:
            if not path.is_file():  # reading a pipe would never end
                raise CorruptEpisode(f"Cannot read {path}: it is missing or not a file.")
            self._heads = BatchHeads(path)
            self._reader: Any = pa.ipc.open_file(_mapped(path) if mapped else pa.OSFile(str(path)))
            if self._reader.schema != _SCHEMA:
                raise CorruptEpisode(f"Cannot read {path}: it has the columns {self._reader.schema.names}.")
        except (pa.ArrowException, OSError, ValueError) as err:
            raise _unreadable(path, err) from err

    def image(self, number: int) -> bytes:
        """Return an image as stored.

        Raises:
            CorruptEpisode: There is no such image, or it cannot be read.
        """
        place, row = divmod(number, IMAGES_IN_A_BATCH)
        if place != self._batch[0]:
            self._batch = (-1, None)  # so that two batches are not held at a time
            self._batch = (place, self._read(place))
        images = self._batch[1]
        if row >= len(images):
            raise CorruptEpisode(f"{self.path} has no image {number}; it is not the file that was written.")
        return images[row].as_py()

    def _read(self, place: int) -> Any:
        if not 0 <= place < self._reader.num_record_batches:
            raise CorruptEpisode(f"{self.path} has no batch {place} of images; it is not the file that was written.")
        try:
            self._heads.refuse_compressed(place)
            batch = self._reader.get_batch(place)
            batch.validate(full=True)
        except (pa.ArrowException, OSError, ValueError) as err:
            raise _unreadable(self.path, err) from err
        if batch.column(0).null_count:
            raise CorruptEpisode(f"{self.path} has batches without images; it is not the file that was written.")
        return batch.column(0)


def _mapped(path: Path) -> pa.Buffer:
    # Not `pa.memory_map`, which asks the system to read ahead.
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return pa.py_buffer(mmap.mmap(fd, 0, access=mmap.ACCESS_READ))
    finally:
        os.close(fd)


def _unreadable(path: Path, err: Exception) -> CorruptEpisode:
    return err if isinstance(err, CorruptEpisode) else CorruptEpisode(f"Cannot read {path}: {err}.")
