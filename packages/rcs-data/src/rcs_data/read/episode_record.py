"""One complete episode, read lazily: only the parts that are used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.about import read_about
from rcs_data.files.codec import blank_frame, decode_frame
from rcs_data.files.feature import Feature
from rcs_data.files.flags import FrameFlag, flags_key
from rcs_data.files.frames_file import FramesFile
from rcs_data.files.info import SIM_STATE, DatasetInfo
from rcs_data.files.layout import FRAMES_FILE, STEPS_FILE, present_folder
from rcs_data.files.steps_file import read_steps, step_groups
from rcs_data.index.entry import Entry
from rcs_data.read.content import flat_numbers

_ROWS_IN_A_PIECE, _BYTES_IN_A_PIECE = 256, 1 << 23


class EpisodeRecord:
    """One complete episode; files are read when they are needed.

    Every property raises `CorruptEpisode` when the file it needs is missing or damaged.
    """

    def __init__(self, path: str | Path, info: DatasetInfo, entry: Entry | None = None) -> None:
        """Name an episode.

        Args:
            path: Its folder, as the index has it.
            info: The facts that the dataset's episodes share.
            entry: Its entry in the index; None to take that from `episode.json`.
        """
        self._text = path
        self.info = info
        self._given = entry

    def __repr__(self) -> str:
        """Name the episode."""
        return f"EpisodeRecord({self.id!r})"

    @cached_property
    def place(self) -> Path:
        """Its folder, as the index has it; made on use, since datasets have many thousands."""
        return Path(self._text)

    @property
    def path(self) -> Path:
        """Its folder. An edit may have replaced the episode since the dataset was opened: its former rows are read."""
        return self.place if self.place.is_dir() else present_folder(self.place)

    @cached_property
    def entry(self) -> Entry:
        """The entry of the episode in the index."""
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
        """The instruction that the robot had."""
        return self.info.instruction if self.entry.instruction is None else self.entry.instruction

    @property
    def outcome(self) -> dict[str, Any]:
        """Everything else that is known about how it went."""
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

    def steps(self, keys: Iterable[str] | None = None) -> pa.Table:
        """Return the rows as stored; an image is its number in `frames.zip`, null before the first.

        Args:
            keys: The columns to read; None for all, with the simulation's states.

        Raises:
            InvalidSetup: There is no such feature.
            CorruptEpisode: The file is missing or damaged.
        """
        names = self.info.stream_schema.names if keys is None else [self.info.feature(key).key for key in keys]
        return self._read(names)

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
        rows = self._read(numbers) if numbers else None
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

    def __getitem__(self, key: str) -> NDArray[Any]:
        """Return one column, as `column` does: `episode["observation/joints"]`."""
        return self.column(key)

    def frames(self, key: str) -> Iterator[NDArray[Any]]:
        """Yield the images of one camera in order: (H, W, 3) uint8, or (H, W) uint16 millimetres for depth.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: A file is missing or damaged; the message has the row.
        """
        feature, numbers = self.info.feature(key), self.image_numbers([key])[key]
        file = FramesFile(self.path / FRAMES_FILE)
        last, image = None, np.empty(0)
        for row, number in enumerate(numbers.tolist()):
            if number != last:
                last, image = number, decoded(feature, file, number, row)
            yield image.copy()

    def encoded_frames(self, key: str) -> Iterator[bytes]:
        """Yield the images of one camera in order, as stored: the bytes of JPEG, QOI or PNG files.

        A row without a new image has the same bytes object as the row before; rows before the first image are black.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: A file is missing or damaged.
        """
        feature, numbers = self.info.feature(key), self.image_numbers([key])[key]
        file = FramesFile(self.path / FRAMES_FILE)
        last, image = None, b""
        for number in numbers.tolist():
            if number != last:
                last, image = number, file.image(number) if number >= 0 else blank_frame(feature, self.info)
            yield image

    def image_numbers(self, keys: Iterable[str]) -> dict[str, NDArray[np.int32]]:
        """Return for each row the number of each image in `frames.zip`, shape (length,); -1 before the first.

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
        return _image_numbers(self.steps(chosen), chosen)

    def rows(self) -> Iterator[pa.Table]:
        """Yield the rows with their images, as recorded, in pieces of at most 256 rows and about 8 MB of images.

        The columns are those of `DatasetInfo.stream_schema`: an image is null where it is that of the row before.

        Raises:
            CorruptEpisode: A file is missing or damaged.
        """
        last: dict[str, int] = {}
        for group in step_groups(self.path / STEPS_FILE, self.info, self.length):
            yield from self.inlined(group, last)
            shown = _image_numbers(group, (f.key for f in self.info.features if f.is_image))
            last = {key: int(column[-1]) for key, column in shown.items() if len(column)}

    def inlined(self, rows: pa.Table, before: Mapping[str, int] | None = None) -> Iterator[pa.Table]:
        """Yield rows with the images themselves instead of their numbers, in pieces as those of `rows`.

        Args:
            rows: Some of what `steps` returned, in order, with the same or other names of columns in their places.
            before: The numbers of the images in the row before the first, by column; None if none were shown.
        """
        keys = [rows.schema.names[place] for place, feature in enumerate(self.info.features) if feature.is_image]
        columns = _image_numbers(rows, keys)
        is_new = {key: np.diff(column, prepend=(before or {}).get(key, -1)) != 0 for key, column in columns.items()}
        file = FramesFile(self.path / FRAMES_FILE) if keys else None
        at = 0
        while at < rows.num_rows:
            images: dict[str, list[bytes | None]] = {key: [] for key in keys}
            until, size = at, 0
            while until < min(at + _ROWS_IN_A_PIECE, rows.num_rows) and size <= _BYTES_IN_A_PIECE:
                for key, kept in images.items():
                    assert file is not None, "there are images"
                    kept.append(file.image(int(columns[key][until])) if is_new[key][until] else None)
                    size += len(kept[-1] or b"")
                until += 1
            piece = rows.slice(at, until - at)
            for key, column in images.items():
                place = piece.schema.get_field_index(key)
                field = piece.schema.field(place).with_type(pa.binary())
                piece = piece.set_column(place, field, pa.array(column, pa.binary()))
            yield piece
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

    def _decoded(self, feature: Feature) -> NDArray[Any]:
        images = np.empty((self.length, *feature.shape), feature.numpy_dtype)
        for row, image in enumerate(self.frames(feature.key)):
            images[row] = image
        return images

    def _read(self, columns: list[str]) -> pa.Table:
        return read_steps(self.path / STEPS_FILE, self.info, self.length, columns)


def decoded(feature: Feature, file: FramesFile, number: int, row: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return an image, black for -1.

    Args:
        feature: The feature.
        file: The images of the episode.
        number: The image.
        row: A row that shows it, for the message.
        out: Where to put it: contiguous, with the feature's shape and dtype; None for a new array.

    Raises:
        CorruptEpisode: It cannot be read; the message has the row.
    """
    if number < 0:
        image: NDArray[Any] = np.empty(feature.shape, feature.numpy_dtype) if out is None else out
        image[...] = 0
        return image
    try:
        return decode_frame(feature, file.image(number), out)
    except CorruptEpisode as err:
        raise CorruptEpisode(f"{file.path}, {feature.key!r}, row {row}: {err}") from err


def _image_numbers(rows: pa.Table, keys: Iterable[str]) -> dict[str, NDArray[np.int32]]:
    return {key: rows.column(key).fill_null(-1).to_numpy() for key in keys}


def _values(rows: pa.Table, feature: Feature) -> NDArray[Any]:
    column = rows.column(feature.key)
    numbers = flat_numbers(column).reshape(-1, *feature.shape)
    if column.null_count and numbers.dtype.kind == "f":
        numbers = numbers.copy()
        numbers[column.is_null().to_numpy()] = np.nan
    return numbers
