"""`frames.zip`: all images of an episode in the order of recording, each at once accessible by its number.

A ZIP file without compression: `00000012.jpg` is image 12, and any program unpacks it. Entries of its directory have
one size, so image 12 is found without reading the others; its CRC-32 is compared whenever it is read.

Python's zipfile reads the whole directory first: of 300 images, it takes 0.8 ms to open the file and read one, beside
0.03 ms here, in turns. A small JPEG is decoded in 0.3 ms, so random access would take three times as long.
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from isal.isal_zlib import crc32

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.durable import HashedFile

# Records of PKWARE's APPNOTE.TXT 6.3.10, little-endian; offsets have 64 bits, so that all entries take as many bytes.
_LOCAL = struct.Struct("<4s5H3I2H12s")
_ENTRY = struct.Struct("<4s6H3I5H2I12sHHQ")
_END64, _LOCATOR, _END = struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI"), struct.Struct("<4s4H2IH")
_TAIL = _END64.size + _LOCATOR.size + _END.size
_VERSION, _DATE, _NAME, _FAR = 45, 33, 12, 0xFFFFFFFF  # ZIP64; 1980-01-01
_KINDS = {b"\xff\xd8": "jpg", b"\x89P": "png", b"qo": "qoi"}


class FramesWriter:
    """Writes `frames.zip` from rows with images; hashed on the way, one image in memory."""

    def __init__(self, path: Path, keys: list[str]) -> None:
        """Start the file, replacing any that is there.

        Args:
            path: The file.
            keys: The columns with images; those of a row are stored in this order.
        """
        self.name = path.name
        self._last = dict.fromkeys(keys, -1)
        self._count = self._size = 0
        self._entries = bytearray()
        self._file = HashedFile(path)

    def __enter__(self) -> FramesWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def numbered(self, rows: pa.Table) -> pa.Table:
        """Store the images of the next rows, and return the rows with the number of each row's image, or null."""
        columns = [rows.column(key) for key in self._last]
        is_new = np.stack([column.is_valid().to_numpy() for column in columns], axis=1)
        numbers = np.where(is_new, self._count + np.cumsum(is_new.reshape(-1)).reshape(is_new.shape) - 1, -1)
        images = [_images(column) for column in columns]
        for place in np.nonzero(is_new)[1].tolist():
            self._store(next(images[place]))
        for (key, last), column in zip(self._last.items(), numbers.T, strict=True):
            shown = np.maximum.accumulate(np.maximum(column, last))
            self._last[key] = int(shown[-1]) if len(shown) else last
            place = rows.schema.get_field_index(key)
            field = rows.schema.field(place).with_type(pa.int32())
            rows = rows.set_column(place, field, pa.array(shown, pa.int32(), mask=shown < 0))
        return rows

    def complete(self) -> str:
        """Write the directory, bring the file to the disk and return its SHA-256."""
        size, start, end = len(self._entries), self._size, self._size + len(self._entries)
        few = min(self._count, 0xFFFF)
        self._file.write(bytes(self._entries))
        self._file.write(
            _END64.pack(b"PK\x06\x06", 44, _VERSION, _VERSION, 0, 0, self._count, self._count, size, start)
            + _LOCATOR.pack(b"PK\x06\x07", 0, end, 1)
            + _END.pack(b"PK\x05\x06", 0, 0, few, few, min(size, _FAR), min(start, _FAR), 0)
        )
        return self._file.complete()

    def _store(self, image: pa.Buffer) -> None:
        data = memoryview(image)
        name = f"{self._count:08d}.{_KINDS.get(bytes(data[:2]), 'bin')}".encode()
        about = (0, 0, 0, _DATE, crc32(data), len(data), len(data), _NAME)
        self._file.write(_LOCAL.pack(b"PK\x03\x04", _VERSION, *about, 0, name))
        self._file.write(data)
        self._entries += _ENTRY.pack(
            b"PK\x01\x02", _VERSION, _VERSION, *about, 12, 0, 0, 0, 0, _FAR, name, 1, 8, self._size
        )
        self._size += _LOCAL.size + len(data)
        self._count += 1


def _images(column: pa.ChunkedArray) -> Iterator[pa.Buffer]:
    for chunk in column.chunks:
        for image in chunk.drop_null():
            yield image.as_buffer()


class FramesFile:
    """An open `frames.zip`; its file is read, not mapped, so that an unreadable sector is an error and no more."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            CorruptEpisode: It is missing or not such a file.
            DatasetError: Too many files are open.
        """
        self.path = path
        if not path.is_file():  # opening a pipe would never end
            raise CorruptEpisode(f"Cannot read {path}: it is missing or not a file.")
        try:
            self._file = path.open("rb", buffering=0)
            self._size = os.fstat(self._file.fileno()).st_size
            mark, *_, count, size, start = _END64.unpack(self._at(self._size - _TAIL, _END64.size))
        except OSError as err:
            if err.errno in (errno.EMFILE, errno.ENFILE):  # which says nothing about this one
                raise DatasetError(f"Cannot open {path}: {err.strerror}. Raise the limit with `ulimit -n`.") from err
            raise CorruptEpisode(f"Cannot read {path}: {err.strerror or err}.") from err
        if mark != b"PK\x06\x06" or size != count * _ENTRY.size or start + size + _TAIL != self._size:
            raise CorruptEpisode(f"Cannot read {path}: it is not the file that was written.")
        self._start, self._count = start, count

    def image(self, number: int) -> bytes:
        """Return an image as stored.

        Raises:
            CorruptEpisode: There is no such image, or it is not what was written.
        """
        if not 0 <= number < self._count:
            raise CorruptEpisode(f"{self.path} has no image {number}; it is not the file that was written.")
        try:
            entry = _ENTRY.unpack(self._at(self._start + number * _ENTRY.size, _ENTRY.size))
            data = self._at(entry[-1] + _LOCAL.size, entry[8])
        except OSError as err:
            raise CorruptEpisode(f"Cannot read {self.path}: {err.strerror or err}.") from err
        if crc32(data) != entry[7]:
            raise CorruptEpisode(f"Image {number} of {self.path} is not what was written.")
        return data

    def _at(self, place: int, count: int) -> bytes:
        data = os.pread(self._file.fileno(), count, place) if 0 <= place <= self._size - count else b""
        if len(data) < count:
            raise CorruptEpisode(f"Cannot read {self.path}: it is not the file that was written.")
        return data
