"""One complete episode, read lazily: only the parts that are used."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data import parquet
from rcs_data.about import read_about
from rcs_data.content import flat_numbers
from rcs_data.episode_images import EpisodeImages
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.feature import Feature
from rcs_data.flags import FrameFlag, flags_key
from rcs_data.frames_file import FramesFile
from rcs_data.index import Entry
from rcs_data.info import SIM_STATE, DatasetInfo
from rcs_data.layout import EPISODE_FILE, FRAMES_FILE, STEPS_FILE
from rcs_data.parquet import UNREADABLE, ParquetSource

_ROWS_IN_A_PIECE, _BYTES_IN_A_PIECE = 256, 1 << 23


class EpisodeRecord:
    """One complete episode; files are read when they are needed.

    Every property raises `CorruptEpisode` when the file it needs is missing or damaged.
    """

    def __init__(self, path: Path, info: DatasetInfo, entry: Entry | None = None) -> None:
        """Name an episode.

        Args:
            path: Its folder.
            info: What the dataset's episodes share.
            entry: What the index has of it; None to take that from `episode.json`.
        """
        self.path = path
        self.info = info
        self._given = entry

    def __repr__(self) -> str:
        """Name the episode."""
        return f"EpisodeRecord({self.id!r})"

    def _repr_html_(self) -> str:
        from rcs_data.view.notebook import episode_html  # which reads episodes itself

        return episode_html(self)

    @cached_property
    def entry(self) -> Entry:
        """What the index has of it."""
        return self._given or Entry.of(read_about(self.path), self.path.name, self.info)

    @property
    def about(self) -> dict[str, Any]:
        """The contents of `episode.json`, with the instruction of today; read anew each time, and kept nowhere."""
        return {**read_about(self.path), "instruction": self.instruction}

    @property
    def id(self) -> str:
        """The name, unique in the dataset."""
        return self.entry.id

    @property
    def seed(self) -> int | None:
        """The seed of the reset."""
        return self.entry.seed

    @property
    def success(self) -> bool | None:
        """Whether the task was done; None if that is not known."""
        return self.entry.success

    @property
    def length(self) -> int:
        """Rows, the reset observation included."""
        return self.entry.length

    @property
    def failure(self) -> str | None:
        """Why it failed, as the outcome says; None if it does not."""
        return self.entry.failure

    @property
    def instruction(self) -> str:
        """What the robot was asked to do."""
        return self.info.instruction if self.entry.instruction is None else self.entry.instruction

    @property
    def outcome(self) -> dict[str, Any]:
        """What else is known about how it went."""
        return self.about["outcome"]

    @property
    def timing(self) -> dict[str, Any]:
        """The timing report: periods, gaps, repeated and dropped images."""
        return self.about["timing"]

    @property
    def content_hash(self) -> str:
        """A hash of all columns except times and flags: equal for runs that are equal bit for bit."""
        return self.entry.content_hash

    @property
    def source(self) -> dict[str, Any] | None:
        """The episode that this one was made from, if any: dataset, episode, content hash, and so on."""
        return self.about.get("source")

    def flags(self, camera: str) -> NDArray[np.uint8]:
        """Return the flags of a camera's frames, a `FrameFlag` per row, shape (length,); 0 where nothing was wrong.

        Args:
            camera: The camera's name.

        Raises:
            CorruptEpisode: The file is missing or damaged.
        """
        key = flags_key(camera)
        if any(feature.key == key for feature in self.info.features):
            return self.column(key)
        return np.full(self.length, FrameFlag(0), np.uint8)

    def steps(self, keys: list[str] | None = None) -> pa.Table:
        """Return the rows as stored; an image is its number in `frames.arrow`, -1 before the first.

        Args:
            keys: The columns to read; None for all.

        Raises:
            InvalidSetup: There is no such feature.
            CorruptEpisode: The file is missing or damaged.
        """
        features = self.info.features if keys is None else map(self.info.feature, keys)
        return self._read([feature.key for feature in features])

    def columns(self, keys: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Return several columns as `column` does, which reads the file once.

        Args:
            keys: The features.

        Raises:
            InvalidSetup: There is no such feature.
            CorruptEpisode: The file is missing or damaged.
        """
        features = [self.info.feature(key) for key in keys]
        numbers = [feature.key for feature in features if not feature.is_image]
        rows = self.steps(numbers) if numbers else None
        return {
            feature.key: self._decoded(feature) if rows is None or feature.is_image else _values(rows, feature)
            for feature in features
        }

    def column(self, key: str) -> NDArray[Any]:
        """Return one column, images decoded, shape (length, *feature.shape).

        A missing value, such as the first row's action, is NaN, 0 for integers, or False for booleans.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature.
            CorruptEpisode: The file is missing or damaged.
        """
        return self.columns([key])[key]

    def frames(self, key: str) -> Iterator[NDArray[Any]]:
        """Yield the images of one camera in order: (H, W, 3) uint8, or (H, W) uint16 millimetres for depth.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: A file is missing or damaged; the message has the row.
        """
        numbers = self.image_numbers([key])[key]
        images = EpisodeImages(self.info.feature(key), self.info, self._frames_file(), numbers)
        last, image = None, np.empty(0)
        for number in numbers.tolist():
            if number != last:
                last, image = number, images.decoded(number)
            yield image.copy()

    def encoded_frames(self, key: str) -> Iterator[bytes]:
        """Yield the images of one camera in order, as stored: the bytes of JPEG, QOI or PNG files.

        Those of a video are QOI. A row without a new image has the same bytes object as the row before; rows before the
        first image are black.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: A file is missing or damaged.
        """
        numbers = self.image_numbers([key])[key]
        images = EpisodeImages(self.info.feature(key), self.info, self._frames_file(), numbers)
        yield from images.shown(numbers)

    def image_numbers(self, keys: Iterable[str]) -> dict[str, NDArray[np.int32]]:
        """Return for each row the number of each image in `frames.arrow`, shape (length,); -1 before the first.

        Args:
            keys: The features.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: The file is missing or damaged.
        """
        chosen = list(keys)
        for key in chosen:
            if not self.info.feature(key).is_image:
                raise InvalidSetup(f"{key!r} is not an image; read it with column({key!r}).")
        return _image_numbers(self.steps(chosen), chosen, self.path)

    def rows(self, start: int = 0, stop: int | None = None, *, packets: bool = False) -> Iterator[pa.Table]:
        """Yield the rows with their images, as recorded, in pieces of at most 256 rows and about 8 MB of images.

        The columns are those of `DatasetInfo.stream_schema`: an image is null where it is that of the row before,
        also in row `start`.

        Args:
            start: The first row.
            stop: The row after the last; None for all.
            packets: Whether images of videos are as stored (`video_packets`) instead of QOI.

        Raises:
            CorruptEpisode: A file is missing or damaged.
        """
        end = self.length if stop is None else min(stop, self.length)
        keys = [feature.key for feature in self.info.features if feature.is_image]
        read = self._encoded(keys, packets=packets)
        last, first = dict.fromkeys(keys, -1), 0
        for group in filter(len, self._groups()):
            numbers = _image_numbers(group, keys, self.path)
            is_new = {key: np.diff(column, prepend=last[key]) != 0 for key, column in numbers.items()}
            last = {key: int(column[-1]) for key, column in numbers.items()}
            at, below = max(start - first, 0), min(end - first, group.num_rows)
            while at < below:
                images, until = _new_images(read, numbers, is_new, range(at, min(at + _ROWS_IN_A_PIECE, below)))
                yield _inline(group.slice(at, until - at), images)
                at = until
            first += group.num_rows

    def numbers(self) -> pa.Table:
        """Return all rows with their simulation states; an image is its number in `frames.arrow`.

        Raises:
            CorruptEpisode: The file is missing or damaged.
        """
        return self._read(self.info.steps_schema.names)

    def inlined(self, numbers: pa.Table) -> Iterator[pa.Table]:
        """Yield rows with the images themselves instead of their numbers, in pieces as those of `rows`.

        Args:
            numbers: Some of what `numbers` returned, in order, with the same or other names of columns in their places.

        Raises:
            CorruptEpisode: The file of the images is missing or damaged.
        """
        names = {f.key: numbers.schema.names[place] for place, f in enumerate(self.info.features) if f.is_image}
        keys = list(names.values())
        read = {names[key]: image for key, image in self._encoded(list(names)).items()}
        columns = _image_numbers(numbers, keys, self.path)
        is_new = {key: np.diff(column, prepend=-1) != 0 for key, column in columns.items()}
        at = 0
        while at < numbers.num_rows:
            rows = range(at, min(at + _ROWS_IN_A_PIECE, numbers.num_rows))
            images, until = _new_images(read, columns, is_new, rows)
            yield _inline(numbers.slice(at, until - at), images)
            at = until

    def sim_state(self) -> NDArray[np.float64]:
        """Return the simulation's state at each step, shape (length, sim_state_size).

        Raises:
            InvalidSetup: The dataset has no simulation state.
            CorruptEpisode: The file is missing or damaged.
        """
        if self.info.sim_state_size is None:
            raise InvalidSetup(f"The dataset of {self.path} has no simulation states.")
        return flat_numbers(self._read([SIM_STATE]).column(SIM_STATE)).reshape(-1, self.info.sim_state_size)

    def _frames_file(self) -> FramesFile:
        return FramesFile(self.path / FRAMES_FILE, mapped=False)

    def _encoded(self, keys: Sequence[str], *, packets: bool = False) -> dict[str, Callable[[int], bytes]]:
        """Return of each feature what reads an image by its number."""
        if not keys:
            return {}
        file, features = self._frames_file(), [self.info.feature(key) for key in keys]
        videos = [] if packets else [feature for feature in features if feature.video is not None]
        read = dict.fromkeys(keys, file.image)
        for key, numbers in (self.image_numbers(f.key for f in videos) if videos else {}).items():
            read[key] = EpisodeImages(self.info.feature(key), self.info, file, numbers).encoded
        return read

    def _decoded(self, feature: Feature) -> NDArray[Any]:
        images = np.empty((self.length, *feature.shape), feature.numpy_dtype)
        for row, image in enumerate(self.frames(feature.key)):
            images[row] = image
        return images

    def _read(self, columns: list[str]) -> pa.Table:
        with self._opened(mapped=True) as source:
            return source.table(columns)

    def _groups(self) -> Iterator[pa.Table]:
        with self._opened(mapped=False) as source:
            source.require()
            for group in range(source.file.num_row_groups):
                yield source.table(None, [group])

    @contextlib.contextmanager
    def _opened(self, *, mapped: bool) -> Generator[ParquetSource]:
        """Open `steps.parquet` and check its rows and columns."""
        path = self.path / STEPS_FILE
        try:
            with parquet.opened(path, mapped=mapped) as source:
                if source.rows != self.length:
                    raise CorruptEpisode(f"{path} has {source.rows} rows, but {EPISODE_FILE} says {self.length}.")
                if not source.schema.equals(self.info.steps_schema):
                    raise CorruptEpisode(f"The columns of {path} differ from the dataset's.")
                yield source
        except UNREADABLE as err:
            raise CorruptEpisode(f"Cannot read {path}: {err}.") from err


def last_valid(column: pa.ChunkedArray) -> NDArray[np.intp]:
    """Return for each row the last row up to it that has a value; row 0 where there is none yet."""
    rows = np.where(column.is_valid().to_numpy(), np.arange(len(column)), 0)
    return np.maximum.accumulate(rows) if len(rows) else rows


def _image_numbers(rows: pa.Table, keys: Iterable[str], folder: Path) -> dict[str, NDArray[np.int32]]:
    columns = {key: rows.column(key) for key in keys}
    if any(column.null_count for column in columns.values()):
        raise CorruptEpisode(f"{folder / STEPS_FILE} has rows without a number of their image.")
    return {key: column.to_numpy() for key, column in columns.items()}


def _values(rows: pa.Table, feature: Feature) -> NDArray[Any]:
    column = rows.column(feature.key)
    numbers = flat_numbers(column).reshape(-1, *feature.shape)
    if feature.can_be_held:
        return numbers[last_valid(column)]
    if column.null_count and numbers.dtype.kind == "f":
        numbers = numbers.copy()
        numbers[column.is_null().to_numpy()] = np.nan
    return numbers


def _new_images(
    read: Mapping[str, Callable[[int], bytes]],
    numbers: Mapping[str, NDArray[np.int32]],
    is_new: Mapping[str, NDArray[np.bool_]],
    rows: range,
) -> tuple[dict[str, list[bytes | None]], int]:
    """Return the new images of some rows, and the row after the last that has room for its own."""
    images: dict[str, list[bytes | None]] = {key: [] for key in numbers}
    size = 0
    for row in rows if images else ():
        for key, kept in images.items():
            image = read[key](int(numbers[key][row])) if is_new[key][row] else None
            kept.append(image)
            size += len(image or b"")
        if size > _BYTES_IN_A_PIECE:
            return images, row + 1
    return images, rows.stop


def _inline(rows: pa.Table, images: Mapping[str, list[bytes | None]]) -> pa.Table:
    """Return rows with the images themselves instead of their numbers."""
    for key, column in images.items():
        place = rows.schema.get_field_index(key)
        rows = rows.set_column(place, rows.schema.field(place).with_type(pa.binary()), pa.array(column, pa.binary()))
    return rows
