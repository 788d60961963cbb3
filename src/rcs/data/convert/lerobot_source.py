"""Reads the files of a LeRobotDataset, v2.0, v2.1 or v3.0, episode by episode."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rcs.data.codec import decode_jpeg
from rcs.data.content import flat_numbers
from rcs.data.convert.video import VideoReader, decode_image
from rcs.errors import CorruptEpisode, DatasetError, InvalidSetup

_VERSIONS = ("v2.0", "v2.1", "v3.0")
_ROWS_AT_A_TIME = 1024


@dataclass(frozen=True, kw_only=True)
class VideoPlace:
    """Where the frames of an episode are."""

    path: Path
    """The video."""
    start: float
    """The time of the first frame [s]."""


@dataclass(frozen=True, kw_only=True)
class SourceEpisode:
    """One episode as the files have it."""

    index: int
    """Its number."""
    tasks: tuple[str, ...]
    """What the robot was asked to do, in the order in which it comes up."""
    table: pa.Table
    """Its frames, without videos."""
    videos: dict[str, VideoPlace]
    """Its videos by column."""

    def numbers(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return a column of numbers, shape (frames, *shape).

        Raises:
            CorruptEpisode: There are too few or too many numbers.
        """
        column = self.table.column(name).combine_chunks()
        while not pa.types.is_fixed_size_list(column.type) and pa.types.is_nested(column.type):
            column = column.flatten()
        numbers = flat_numbers(column)
        if numbers.size != len(self.table) * int(np.prod(shape)):
            rows = len(self.table)
            raise CorruptEpisode(
                f"Column {name!r} of episode {self.index} has {numbers.size} numbers in {rows} rows of {shape}."
            )
        return numbers.reshape(len(self.table), *shape)

    def images(self, name: str, shape: tuple[int, ...], readers: dict[str, VideoReader], fps: float) -> Iterator[Any]:
        """Yield the images of a column, (H, W, 3) uint8, one at a time.

        Args:
            name: The column.
            shape: The shape of each.
            readers: Videos that are open, by column; kept between calls, for the next episode may go on in the same.
            fps: Frames per second.

        Raises:
            CorruptEpisode: An image is missing, damaged, or of another shape.
        """
        for image in self._stored(name, shape) if name not in self.videos else self._decoded(name, readers, fps):
            if image.shape != shape:
                raise CorruptEpisode(f"An image of {name!r} in episode {self.index} is {image.shape}, not {shape}.")
            yield image

    def _decoded(self, name: str, readers: dict[str, VideoReader], fps: float) -> Iterator[NDArray[np.uint8]]:
        place = self.videos[name]
        if name in readers and readers[name].path != place.path:
            readers.pop(name).close()
        if name not in readers:
            readers[name] = VideoReader(place.path)
        yield from readers[name].frames(place.start, len(self.table), fps)

    def _stored(self, name: str, shape: tuple[int, ...]) -> Iterator[NDArray[np.uint8]]:
        for item in self.table.column(name):
            data = (item.as_py() or {}).get("bytes")
            if not data:
                raise CorruptEpisode(
                    f"Column {name!r} of episode {self.index} names image files but does not have them."
                )
            yield decode_jpeg(data, shape) if data.startswith(b"\xff\xd8") else decode_image(data)


class LeRobotSource:
    """A LeRobotDataset on disk."""

    def __init__(self, root: Path) -> None:
        """Read what describes it.

        Args:
            root: The folder.

        Raises:
            DatasetError: There is none, or it is of another version.
            CorruptEpisode: A file that describes it is damaged.
        """
        self.root = root
        path = root / "meta" / "info.json"
        if not path.is_file():
            raise DatasetError(f"There is no LeRobot dataset in {root}: meta/info.json is missing.")
        self.info = read_json(path)
        self.version = str(self.info.get("codebase_version"))
        if self.version not in _VERSIONS:
            raise DatasetError(f"{root} is a LeRobot dataset {self.version}; readable are {', '.join(_VERSIONS)}.")
        try:
            self.fps = float(self.info["fps"])
            self.features: dict[str, Any] = dict(self.info["features"])
            self.frames = int(self.info.get("total_frames", 0))
            self._lengths, self._about = self._read_episodes()
            self.tasks = self._read_tasks()
        except (KeyError, TypeError, ValueError, OSError, pa.ArrowException) as err:
            raise CorruptEpisode(f"What describes the LeRobot dataset in {root} is damaged: {err!r}.") from err
        if not self._lengths:
            raise InvalidSetup(f"The LeRobot dataset in {root} has no episodes.")

    @property
    def lengths(self) -> dict[int, int]:
        """The number of frames of each episode."""
        return dict(self._lengths)

    def episodes(self) -> Iterator[SourceEpisode]:
        """Yield the episodes in the order of the files; the numbers of one at a time are in memory.

        Raises:
            CorruptEpisode: Rows are missing or damaged.
        """
        left = dict(self._lengths)
        for index, table in self._tables():
            if left.pop(index, None) != len(table):
                told = self._lengths.get(index, 0)
                raise CorruptEpisode(f"Episode {index} of {self.root} has {len(table)} rows, and should have {told}.")
            used = dict.fromkeys(table.column("task_index").to_pylist()) if "task_index" in table.column_names else {}
            yield SourceEpisode(
                index=index,
                tasks=tuple(self.tasks[i] for i in used if i in self.tasks),
                table=table,
                videos={name: self._video(name, index) for name, f in self.features.items() if f["dtype"] == "video"},
            )
        if left:
            raise CorruptEpisode(f"Episodes {sorted(left)[:10]} of {self.root} are described but have no rows.")

    def _tables(self) -> Iterator[tuple[int, pa.Table]]:
        """Yield the rows of one episode after the other, wherever files and pieces of files end."""
        parts: list[pa.Table] = []
        current: int | None = None
        for path in sorted((self.root / "data").glob("*/*.parquet")):
            try:
                with pq.ParquetFile(path) as file:
                    for batch in file.iter_batches(_ROWS_AT_A_TIME, use_threads=False):
                        for index, part in _by_episode(pa.Table.from_batches([batch])):
                            if index != current and parts and current is not None:
                                yield current, pa.concat_tables(parts)
                                parts = []
                            current = index
                            parts.append(part)
            except (pa.ArrowException, OSError) as err:
                raise CorruptEpisode(f"{path} does not read: {err}.") from err
        if parts and current is not None:
            yield current, pa.concat_tables(parts)

    def _video(self, name: str, index: int) -> VideoPlace:
        pattern = str(self.info["video_path"])
        if self.version == "v3.0":
            about = self._about[index]
            where = {f"{part}_index": about[f"videos/{name}/{part}_index"] for part in ("chunk", "file")}
            path, start = pattern.format(video_key=name, **where), float(about[f"videos/{name}/from_timestamp"])
        else:
            chunk = index // int(self.info.get("chunks_size", 1000))
            path, start = pattern.format(video_key=name, episode_chunk=chunk, episode_index=index), 0.0
        return VideoPlace(path=self.root / path, start=start)

    def _read_episodes(self) -> tuple[dict[int, int], dict[int, dict[str, Any]]]:
        if self.version != "v3.0":
            rows = read_json_lines(self.root / "meta" / "episodes.jsonl")
        else:
            rows = []
            for path in sorted((self.root / "meta" / "episodes").glob("*/*.parquet")):
                with pq.ParquetFile(path) as file:
                    names = [name for name in file.schema_arrow.names if not name.startswith("stats/")]
                    rows += file.read(columns=names).to_pylist()
        about = {int(row["episode_index"]): row for row in rows}
        return {index: int(row["length"]) for index, row in about.items()}, about

    def _read_tasks(self) -> dict[int, str]:
        if self.version != "v3.0":
            rows = read_json_lines(self.root / "meta" / "tasks.jsonl")
            return {int(row["task_index"]): str(row["task"]) for row in rows}
        table = pq.read_table(self.root / "meta" / "tasks.parquet")
        # The instruction is the index of a pandas frame, whose column has whatever name.
        words = next(name for name in table.column_names if name != "task_index")
        return dict(zip(table.column("task_index").to_pylist(), table.column(words).to_pylist(), strict=True))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file.

    Raises:
        CorruptEpisode: It is missing or no JSON object.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as err:
        raise CorruptEpisode(f"{path} is missing or damaged: {err}.") from err
    if not isinstance(values, dict):
        raise CorruptEpisode(f"{path} is damaged: it is no JSON object.")
    return values


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """Read a file with a JSON object per line.

    Raises:
        CorruptEpisode: It is missing, or a line is no JSON.
    """
    try:
        # Not `splitlines`, which also takes a line separator within an instruction for the end of a line.
        return [json.loads(line) for line in path.read_text(encoding="utf-8").split("\n") if line.strip()]
    except (OSError, ValueError) as err:
        raise CorruptEpisode(f"{path} is missing or damaged: {err}.") from err


def _by_episode(table: pa.Table) -> Iterator[tuple[int, pa.Table]]:
    numbers = table.column("episode_index").to_numpy()
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    for start, stop in pairwise(edges):
        if stop > start:
            yield int(numbers[start]), table.slice(start, stop - start)
