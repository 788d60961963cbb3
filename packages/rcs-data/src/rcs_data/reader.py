"""Reads a dataset lazily: its episodes one by one, and only the parts of each that are used."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Generator, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data import parquet
from rcs_data.about import read_about
from rcs_data.codec import blank_frame, decode_frame
from rcs_data.content import flat_numbers
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.flags import FrameFlag, flags_key
from rcs_data.index import Edit, Entry, State
from rcs_data.info import DatasetInfo
from rcs_data.journal import Journal
from rcs_data.layout import (
    EPISODE_FILE,
    SIM_STATE_FILE,
    STEPS_FILE,
    episode_folder,
)
from rcs_data.parquet import UNREADABLE, ParquetSource
from rcs_data.rows import SIM_STATE, sim_state_schema, steps_schema


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

    @cached_property
    def about(self) -> dict[str, Any]:
        """The contents of `episode.json`, with the instruction of today."""
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
        """Return the rows as stored, images still encoded.

        Args:
            keys: The columns to read; None for all.

        Raises:
            CorruptEpisode: The file is missing or damaged.
        """
        if keys is not None:
            keys = [self.info.feature(key).key for key in keys]
        return self._read(STEPS_FILE, keys)

    def column(self, key: str) -> NDArray[Any]:
        """Return one column, images decoded, shape (length, *feature.shape).

        A missing value, such as the first row's action, is NaN, 0 for integers, or False for booleans.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature.
            CorruptEpisode: The file is missing or damaged.
        """
        feature = self.info.feature(key)
        if feature.is_image:
            images = list(self.frames(key))
            return np.stack(images) if images else np.empty((0, *feature.shape), feature.numpy_dtype)
        column = self.steps([key]).column(key)
        numbers = flat_numbers(column).reshape(-1, *feature.shape)
        if feature.can_be_held:
            return numbers[_last_valid(column)]
        if column.null_count and numbers.dtype.kind == "f":
            numbers = numbers.copy()
            numbers[column.is_null().to_numpy()] = np.nan
        return numbers

    def frames(self, key: str) -> Iterator[NDArray[Any]]:
        """Yield the images of one camera in order: (H, W, 3) uint8, or (H, W) uint16 millimetres for depth.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: The file is missing or damaged; the message has the row.
        """
        feature = self.info.feature(key)
        last, image = None, None
        for row, data in enumerate(self.encoded_frames(key)):
            if data is not last or image is None:
                try:
                    image = decode_frame(feature, data)
                except CorruptEpisode as err:
                    raise CorruptEpisode(f"{self.path / STEPS_FILE}, {key!r}, row {row}: {err}") from err
                last = data
            yield image.copy()

    def encoded_frames(self, key: str) -> Iterator[bytes]:
        """Yield the images of one camera in order, as stored: JPEG files, or losslessly compressed ones.

        A row without a new image has the same bytes object as the row before; rows before the first image are black.

        Args:
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: The file is missing or damaged.
        """
        feature = self.info.feature(key)
        if not feature.is_image:
            raise InvalidSetup(f"{key!r} is not an image; read it with column({key!r}).")
        last: bytes | None = None
        path = self.path / STEPS_FILE
        try:
            with self._opened(path) as source:
                source.require([key])
                for batch in source.batches([key]):
                    for image in batch.column(0).to_pylist():
                        shown: bytes = image or last or blank_frame(feature, self.info)
                        last = shown
                        yield shown
        except UNREADABLE as err:
            raise CorruptEpisode(f"Cannot read {path}: {err}.") from err

    def sim_state(self) -> NDArray[np.float64]:
        """Return the simulation's state at each step, shape (length, sim_state_size).

        Raises:
            InvalidSetup: The dataset has no simulation state.
            CorruptEpisode: The file is missing or damaged.
        """
        if self.info.sim_state_size is None:
            raise InvalidSetup(f"The dataset of {self.path} has no simulation states.")
        column = self._read(SIM_STATE_FILE, None).column(SIM_STATE)
        return flat_numbers(column).reshape(-1, self.info.sim_state_size)

    def _read(self, name: str, columns: list[str] | None) -> pa.Table:
        path = self.path / name
        try:
            with self._opened(path) as source:
                return source.table(columns)
        except UNREADABLE as err:
            raise CorruptEpisode(f"Cannot read {path}: {err}.") from err

    @contextlib.contextmanager
    def _opened(self, path: Path) -> Generator[ParquetSource]:
        """Open a file of this episode and check its rows and columns."""
        schema = steps_schema(self.info)
        if path.name == SIM_STATE_FILE:
            schema = sim_state_schema(self.info.sim_state_size or 1)
        with parquet.opened(path, mapped=True) as source:
            if source.rows != self.length:
                raise CorruptEpisode(f"{path} has {source.rows} rows, but {EPISODE_FILE} says {self.length}.")
            if not source.file.schema_arrow.equals(schema):
                raise CorruptEpisode(f"The columns of {path} differ from the dataset's.")
            yield source


class Dataset:
    """A dataset on disk, for reading; one that is being recorded can be read too."""

    def __init__(self, path: Path, state: State) -> None:
        """Hold a dataset; use `open` to get one.

        Args:
            path: The folder.
            state: What the index says.
        """
        self.path = path
        self.info = state.info
        self.history: tuple[Edit, ...] = tuple(state.history)
        """The edits, oldest first."""
        self.episodes = tuple(
            EpisodeRecord(episode_folder(path, entry.folder), state.info, entry)
            for _, entry in sorted(state.episodes.items())
        )
        """The complete episodes, sorted by id."""

    @classmethod
    def open(cls, path: str | Path) -> Dataset:
        """Open the dataset in a folder.

        Args:
            path: The folder with `dataset.json` and the index.

        Raises:
            DatasetError: There is no dataset, or its layout is of another version.
            CorruptEpisode: The index is damaged.
        """
        root = Path(path)
        return cls(root, Journal(root).state)

    def digest(self) -> str:
        """Return one SHA-256 over all episodes except times and flags: equal for two runs of one collection."""
        total = hashlib.sha256()
        for episode in self.episodes:
            total.update(f"{episode.id} {episode.content_hash}\n".encode())
        return total.hexdigest()

    def to_arrow(self, keys: list[str] | None = None) -> pa.Table:
        """Return all columns of numbers of all episodes as one table, preceded by "episode" (id) and "row".

        Held values are filled in. A missing value, such as the first row's action, is null.

        Args:
            keys: The columns to read; None for all but images.

        Raises:
            InvalidSetup: There is no such feature, or it is an image.
            CorruptEpisode: An episode is damaged.
        """
        features = [f for f in self.info.features if not f.is_image] if keys is None else map(self.info.feature, keys)
        chosen = {feature.key: feature for feature in features}
        images = [key for key, feature in chosen.items() if feature.is_image]
        if images:
            raise InvalidSetup(
                f"{', '.join(images)}: image columns cannot be tabulated; read them with `FrameAccess` or `frames`."
            )
        fields = [pa.field("episode", pa.string()), pa.field("row", pa.int64())]
        tables = [pa.schema([*fields, *(feature.arrow_field for feature in chosen.values())]).empty_table()]
        for episode in self.episodes:
            rows = episode.steps(list(chosen))
            columns = [rows.column(key) for key in chosen]
            whole = [
                c.take(pa.array(_last_valid(c))) if chosen[k].can_be_held else c
                for k, c in zip(chosen, columns, strict=True)
            ]
            place = [pa.array([episode.id] * len(rows), pa.string()), pa.array(range(len(rows)), pa.int64())]
            tables.append(pa.Table.from_arrays([*place, *whole], schema=tables[0].schema))
        return pa.concat_tables(tables)

    def __repr__(self) -> str:
        """Name the dataset and say how many episodes it has."""
        return f"Dataset({str(self.path)!r}, {len(self)} episodes)"

    def _repr_html_(self) -> str:
        from rcs_data.view.notebook import dataset_html  # which reads datasets itself

        return dataset_html(self)

    def __iter__(self) -> Iterator[EpisodeRecord]:
        """Yield the complete episodes, sorted by id."""
        return iter(self.episodes)

    def __contains__(self, episode: object) -> bool:
        """Return whether the dataset has a complete episode, given its id or record."""
        if isinstance(episode, EpisodeRecord):
            return episode in self.episodes
        return episode in self._by_id

    def __len__(self) -> int:
        """Return the number of complete episodes."""
        return len(self.episodes)

    def __getitem__(self, episode_id: str) -> EpisodeRecord:
        """Return the episode with this id.

        Raises:
            InvalidSetup: There is none.
        """
        try:
            return self._by_id[episode_id]
        except KeyError:
            known = f"which has {len(self)} episodes"
            raise InvalidSetup(f"There is no episode {episode_id!r} in {self.path}, {known}.") from None

    @cached_property
    def _by_id(self) -> dict[str, EpisodeRecord]:
        return {episode.id: episode for episode in self.episodes}


def _last_valid(column: pa.ChunkedArray) -> NDArray[np.intp]:
    """Return for each row the last row up to it that has a value; row 0 where there is none yet."""
    rows = np.where(column.is_valid().to_numpy(), np.arange(len(column)), 0)
    return np.maximum.accumulate(rows) if len(rows) else rows
