"""Reads the files of a LeRobotDataset, v2.0, v2.1 or v3.0, episode by episode."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter
from pathlib import Path
from string import Formatter
from typing import Annotated, Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from msgspec import Meta
from numpy.typing import NDArray
from typing_extensions import NotRequired, TypedDict

from rcs_data.convert.images import as_stored
from rcs_data.convert.lerobot.layout import RCS_FILE, TEXT
from rcs_data.convert.lerobot.video import VideoReader
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.json_file import check_fields, read_json, read_json_lines
from rcs_data.files.text import mended_text
from rcs_data.read.content import flat_numbers

_VERSIONS = ("v2.0", "v2.1", "v3.0")
_ROWS_AT_A_TIME = 64
_POINTER = b"version https://git-lfs"
_DATA_PATHS = {
    "v3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
}


class _Described(TypedDict):
    """An entry of `info.json` for a column, as far as it is used."""

    dtype: str
    shape: list[Annotated[int, Meta(ge=1)]]


class _Info(TypedDict):
    """The contents of `info.json`, as far as they are used."""

    fps: Annotated[float, Meta(gt=0)]
    features: dict[str, _Described]
    chunks_size: NotRequired[Annotated[int, Meta(ge=1)]]


class _Row(TypedDict):
    """The description of an episode, as far as all versions have it."""

    episode_index: Annotated[int, Meta(ge=0)]
    length: Annotated[int, Meta(ge=0)]


@dataclass(frozen=True, kw_only=True)
class SourceEpisode:
    """One episode as stored."""

    source: LeRobotSource
    """Its dataset."""
    index: int
    """Its number."""
    table: pa.Table
    """Its frames without videos."""

    def numbers(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return a column of numbers, shape (frames, *shape); CorruptEpisode if there are too few or too many."""
        column = self._column(name).combine_chunks()
        while pa.types.is_list(column.type) or pa.types.is_large_list(column.type):
            column = column.flatten()
        kind = column.type.value_type if pa.types.is_fixed_size_list(column.type) else column.type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
            raise CorruptEpisode(f"Column {name!r} of episode {self.index} has {column.type} instead of numbers.")
        numbers, rows = flat_numbers(column), len(self.table)
        if numbers.size != rows * int(np.prod(shape)):
            raise CorruptEpisode(
                f"Column {name!r} of episode {self.index} has {numbers.size} numbers in {rows} rows of {shape}."
            )
        return numbers.reshape(rows, *shape)

    def texts(self, name: str) -> list[str]:
        """Return the text of every row of a column: its own, or that which its number stands for."""
        values = self._column(name).to_pylist()
        if self.source.features[name]["dtype"] == TEXT:
            return [mended_text(str(value or "")) for value in values]
        known = self.source.subtasks if name == "subtask_index" else self.source.tasks
        return [known.get(value, str(value)) for value in values]

    def images(
        self, name: str, feature: Feature, readers: dict[str, VideoReader]
    ) -> Iterator[NDArray[np.uint8] | bytes]:
        """Yield the images of a column one by one: as they are where the feature keeps such, else as arrays.

        Args:
            name: The column.
            feature: The feature that they become.
            readers: Open videos by column, kept between calls, since the next episode may continue in the same one.

        Raises:
            CorruptEpisode: An image is missing, damaged, or of another shape.
        """
        if not self.source.is_video(name):
            for data in self._stored(name):
                yield as_stored(feature, data, f"{name!r} in episode {self.index}")
            return
        for image in self._filmed(name, readers):
            if image.shape != feature.shape:
                raise CorruptEpisode(
                    f"Image of {name!r} in episode {self.index}: expected {feature.shape}; got {image.shape}."
                )
            yield image

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self.table.column_names:
            raise CorruptEpisode(f"Episode {self.index} has no column {name!r}, which info.json describes.")
        return self.table.column(name)

    def _filmed(self, name: str, readers: dict[str, VideoReader]) -> Iterator[NDArray[np.uint8]]:
        path, start = self.source.video(name, self.index)
        if name in readers and readers[name].path != path:
            readers.pop(name).close()
        if name not in readers:
            refuse_pointer(path)
            readers[name] = VideoReader(path)
        yield from readers[name].frames(start, len(self.table), self.source.fps)

    def _stored(self, name: str) -> Iterator[bytes]:
        for item in self._column(name):
            stored = item.as_py()
            data = stored.get("bytes") if isinstance(stored, dict) else stored
            if not data or not isinstance(data, bytes):
                raise CorruptEpisode(
                    f"Column {name!r} of episode {self.index} names image files but does not have them."
                )
            yield data


class LeRobotSource:
    """A LeRobotDataset on disk."""

    def __init__(self, root: Path) -> None:
        """Read its description.

        Raises:
            DatasetError: There is no such dataset, or its version is not supported.
            CorruptEpisode: Its description is damaged.
        """
        self.root = root
        path = root / "meta" / "info.json"
        if not path.is_file():
            raise DatasetError(f"There is no LeRobot dataset in {root}: meta/info.json is missing.")
        refuse_pointer(path)
        self.info = read_json(path)
        self.version = str(self.info.get("codebase_version"))
        if self.version not in _VERSIONS:
            raise DatasetError(f"{root} is a LeRobot dataset {self.version}; supported: {', '.join(_VERSIONS)}.")
        try:
            check_fields(self.info, _Info)
            self.fps, self.features = float(self.info["fps"]), self.info["features"]
            self._chunks_size = self.info.get("chunks_size", 1000)
            self._about = {row["episode_index"]: row for row in self._read_episodes()}
            check_fields([*self._about.values()], list[_Row])
            self.tasks = self._read_tasks()
            path = root / "meta" / "subtasks.parquet"
            self.subtasks = self._read_texts(path, "subtask_index") if path.is_file() else {}
        except DatasetError:
            raise
        except (msgspec.ValidationError, KeyError, TypeError) as err:
            raise CorruptEpisode(f"The description of the LeRobot dataset in {root} is damaged: {err!r}.") from err
        if not self._about:
            raise InvalidSetup(f"The LeRobot dataset in {root} has no episodes.")
        self.lengths = {index: int(row["length"]) for index, row in self._about.items()}
        self.ours = read_json(root / RCS_FILE) if (root / RCS_FILE).is_file() else {}
        """The contents of `meta/rcs.json`, which our exports have; empty for others."""

    def files(self, episodes: Sequence[int]) -> dict[Path, list[int]]:
        """Return the episodes in each Parquet file, relative to the folder."""
        found: dict[Path, list[int]] = {}
        pattern = self.info.get("data_path", _DATA_PATHS["v3.0" if self.version == "v3.0" else "v2.1"])
        for index in episodes:
            found.setdefault(filled(pattern, self._place("data", index)), []).append(index)
        return found

    def is_video(self, name: str) -> bool:
        """Return whether a column's images are in videos."""
        return self.features[name]["dtype"] == "video"

    def video(self, name: str, index: int) -> tuple[Path, float]:
        """Return an episode's video and the time of its first frame [s]; CorruptEpisode if it has no such place."""
        start = self._about[index].get(f"videos/{name}/from_timestamp") if self.version == "v3.0" else 0.0
        if not isinstance(start, int | float) or not 0 <= start < math.inf:
            raise CorruptEpisode(f"The video {name!r} of episode {index} in {self.root} begins at {start!r} s.")
        where = {"video_key": name, **self._place(f"videos/{name}", index)}
        return self.root / filled(self.info.get("video_path"), where), float(start)

    def episodes(
        self, path: Path, numbers: Sequence[int], columns: Sequence[str] | None = None
    ) -> Iterator[SourceEpisode]:
        """Yield the episodes of these numbers in a file, one at a time in memory; with all `columns` if they are None.

        Raises:
            CorruptEpisode: Rows are missing or damaged.
        """
        left = set(numbers)
        file = self.root / path
        with _opened(file) as source:
            kept = None if columns is None else ["episode_index", *columns]
            missing = [name for name in kept or () if name not in source.schema_arrow.names]
            if missing:
                raise CorruptEpisode(f"{file} lacks the column {missing[0]} listed in info.json.")
            batches = source.iter_batches(_ROWS_AT_A_TIME, columns=kept, use_threads=False)
            tables = (pa.Table.from_batches([batch]) for batch in batches)
            parts = (part for table in tables for part in _by_episode(table, file))
            for index, group in groupby(parts, itemgetter(0)):
                if index in left:
                    rows = pa.concat_tables([part for _, part in group])
                    if len(rows) != (length := self.lengths[index]):
                        raise CorruptEpisode(f"Episode {index} of {self.root} has {len(rows)} rows; expected {length}.")
                    left.remove(index)
                    yield SourceEpisode(source=self, index=index, table=rows)
        if left:
            raise CorruptEpisode(f"Episodes {sorted(left)[:10]} of {self.root} are described but have no rows.")

    def _place(self, what: str, index: int) -> dict[str, object]:
        if self.version == "v3.0":
            return {f"{part}_index": self._about[index].get(f"{what}/{part}_index") for part in ("chunk", "file")}
        return {"episode_chunk": index // self._chunks_size, "episode_index": index}

    def _read_episodes(self) -> Iterator[dict[str, Any]]:
        if self.version != "v3.0":
            yield from read_json_lines(self.root / "meta" / "episodes.jsonl")
            return
        for path in sorted((self.root / "meta" / "episodes").glob("*/*.parquet")):
            with _opened(path) as source:
                names = [name for name in source.schema_arrow.names if not name.startswith("stats/")]
                yield from source.read(names, use_threads=False).to_pylist()

    def _read_tasks(self) -> dict[int, str]:
        if self.version == "v3.0":
            return self._read_texts(self.root / "meta" / "tasks.parquet", "task_index")
        rows = read_json_lines(self.root / "meta" / "tasks.jsonl")
        return {row["task_index"]: str(row["task"]) for row in rows}

    def _read_texts(self, path: Path, number: str) -> dict[int, str]:
        with _opened(path) as source:
            table = source.read(use_threads=False)
        # The text is the index of a pandas frame, whose column may have any name.
        words = [name for name in table.column_names if name != number]
        if number not in table.column_names or not words:
            raise CorruptEpisode(f"{path} has columns {table.column_names}; it must have {number} and the words.")
        texts = zip(table.column(number).to_pylist(), table.column(words[0]).to_pylist(), strict=True)
        return {index: mended_text(str(text)) for index, text in texts}


@contextlib.contextmanager
def _opened(path: Path) -> Generator[pq.ParquetFile]:
    """Open a Parquet file.

    Raises:
        CorruptEpisode: It is not one, or cannot be read inside of the block.
    """
    if not path.is_file():  # opening a pipe would never end
        raise CorruptEpisode(f"Cannot read {path}: it is missing or not a file.")
    refuse_pointer(path)
    try:
        with pq.ParquetFile(path.absolute()) as file:  # Arrow takes a relative "run:1/…" for an address
            yield file
    except DatasetError:
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError, OverflowError) as err:
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err


def refuse_pointer(path: Path) -> None:
    """Raise CorruptEpisode, which says what to do, if Git has left a pointer in place of a large file."""
    if not path.is_file():  # opening a pipe would never end
        return
    with path.open("rb") as file:
        is_pointer = file.read(len(_POINTER)) == _POINTER
    if is_pointer:
        raise CorruptEpisode(
            f"{path} is a Git LFS pointer, not the file itself. Fetch the files with `git lfs pull` in their folder."
        )


def filled(pattern: object, values: Mapping[str, object]) -> Path:
    """Return the path of a pattern such as "videos/{video_key}/episode_{episode_index:06d}.mp4", given its values.

    Raises:
        CorruptEpisode: It is not a pattern, or leads out of its folder.
    """
    try:
        fields = [(name, spec) for _, name, spec, _ in Formatter().parse(pattern if isinstance(pattern, str) else "")]
        fits = all(
            name in values and re.fullmatch(r"(0\d{1,2}d)?", spec or "") for name, spec in fields if name is not None
        )
        path = Path(str(pattern).format_map(values)) if fields and fits else None
    except ValueError:
        path = None
    if path is None:
        raise CorruptEpisode(f"The pattern {pattern!r:.200} does not fit {sorted(values)}.")
    if path.is_absolute() or ".." in path.parts:
        raise CorruptEpisode(f"The pattern {pattern!r:.200} leads out of the folder, to {path}.")
    return path


def _by_episode(table: pa.Table, path: Path) -> Iterator[tuple[int, pa.Table]]:
    if "episode_index" not in table.column_names or not pa.types.is_integer(table.schema.field("episode_index").type):
        raise CorruptEpisode(f"{path} has no column episode_index of whole numbers.")
    numbers = table.column("episode_index").fill_null(-1).to_numpy()
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    for start, stop in pairwise(edges):
        if stop > start:
            yield int(numbers[start]), table.slice(start, stop - start)
