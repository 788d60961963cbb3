"""The files of a LeRobotDataset: v3.0 has many episodes in each Parquet file and video, v2.1 files per episode.

lerobot 0.4 and newer read v3.0; openpi, lerobot 0.3 and GR00T read v2.1.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rcs_data.convert.lerobot.layout import TEXT, LeRobotLayout
from rcs_data.convert.lerobot.stats import QUANTILES, DatasetStats, ImageHistogram, Stats
from rcs_data.convert.lerobot.video import VideoJoiner

CHUNK = 1000
"""Most files per folder."""
_DATA_MB, _VIDEO_MB = 100, 200
_EPISODES_AT_A_TIME = 100
_SHARED = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_OWN = "episode_{episode_index:06d}"


@dataclass(frozen=True, kw_only=True)
class EncodedEpisode:
    """An encoded episode, ready to be put in place by a version of the format."""

    index: int
    """Its number among the exported ones."""
    first: int
    """The number of its first frame in the dataset."""
    tasks: list[str]
    """Its instructions, in order of appearance."""
    table: pa.Table
    """Its columns."""
    videos: dict[str, Path]
    """Its videos by column; each must be moved, or joined and removed."""
    stats: dict[str, Stats]
    """Its statistics by column."""
    numbers: dict[str, NDArray[Any]]
    """Its columns of numbers, for the dataset's statistics."""
    histograms: dict[str, ImageHistogram]
    """Histograms of its images, for the dataset's statistics."""


class LeRobotWriter(ABC):
    """Writes encoded episodes one after the other; each version says where."""

    codebase_version: str
    data_path: str
    video_path: str

    def __init__(self, root: Path, layout: LeRobotLayout, robot: str, tasks: list[str], subtasks: list[str]) -> None:
        """Start a dataset of a robot with all its instructions and subtasks, in the folder `root`."""
        self.root, self.layout, self._robot = root, layout, robot
        self._tasks, self._subtasks = tasks, subtasks
        self._total = DatasetStats()
        self.episodes = self._frames = 0

    def add(self, episode: EncodedEpisode) -> None:
        """Write the next episode."""
        length = episode.table.num_rows
        self._place(episode, {"episode_index": episode.index, "tasks": episode.tasks, "length": length})
        self._total.add(episode.numbers, episode.histograms)
        self.episodes += 1
        self._frames += length

    def finish(self) -> None:
        """Close all files and write those that need all episodes; DatasetError if a video has wrong frames."""
        meta = self.root / "meta"
        info = {
            "codebase_version": self.codebase_version,
            "robot_type": self._robot,
            "total_episodes": self.episodes,
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "fps": self.layout.fps,
            "splits": {"train": f"0:{self.episodes}"},
            "features": self.layout.features(),
            **self._finish(meta),
            "data_path": self.data_path,
            "video_path": self.video_path if self.layout.cameras else None,
        }
        write_json(meta / "info.json", info)
        # A file of v2.0 that some readers of v2.1 still need.
        write_json(meta / "stats.json", self._total.to_json())
        if self._subtasks:
            pq.write_table(_text_table(self._subtasks, "subtask_index"), meta / "subtasks.parquet")

    def abort(self) -> None:  # noqa: B027  v2.1 leaves no file open
        """Close all files without completing them."""

    @abstractmethod
    def _place(self, episode: EncodedEpisode, about: dict[str, Any]) -> None:
        """Write an episode's rows, videos and description."""

    @abstractmethod
    def _finish(self, meta: Path) -> dict[str, Any]:
        """Close all files, write the tasks, and return what else `info.json` has."""


class V21Writer(LeRobotWriter):
    """Writes v2.1."""

    codebase_version = "v2.1"
    data_path = "data/chunk-{episode_chunk:03d}/" + _OWN + ".parquet"
    video_path = "videos/chunk-{episode_chunk:03d}/{video_key}/" + _OWN + ".mp4"

    def __init__(self, *given: Any) -> None:
        """Start a dataset; see `LeRobotWriter`."""
        super().__init__(*given)
        self._about: list[dict[str, Any]] = []
        self._stats: list[dict[str, Any]] = []

    def _place(self, episode: EncodedEpisode, about: dict[str, Any]) -> None:
        where = {"episode_chunk": episode.index // CHUNK, "episode_index": episode.index}
        pq.write_table(episode.table, _parent_made(self.root / self.data_path.format(**where)), compression="snappy")
        for name, video in episode.videos.items():
            video.rename(_parent_made(self.root / self.video_path.format(**where, video_key=name)))
        self._about.append(about)
        self._stats.append({"episode_index": episode.index, "stats": episode.stats})

    def _finish(self, meta: Path) -> dict[str, Any]:
        write_json_lines(meta / "episodes.jsonl", self._about)
        write_json_lines(meta / "episodes_stats.jsonl", self._stats)
        write_json_lines(meta / "tasks.jsonl", ({"task_index": i, "task": t} for i, t in enumerate(self._tasks)))
        return {"total_videos": self.episodes * len(self.layout.cameras), "total_chunks": -(-self.episodes // CHUNK)}


class V3Writer(LeRobotWriter):
    """Writes v3.0."""

    codebase_version = "v3.0"
    data_path = f"data/{_SHARED}.parquet"
    video_path = "videos/{video_key}/" + _SHARED + ".mp4"

    def __init__(self, *given: Any, data_limit: int = _DATA_MB << 20, video_limit: int = _VIDEO_MB << 20) -> None:
        """Start a dataset; see `LeRobotWriter`. A new Parquet file or video begins at these sizes [B]."""
        super().__init__(*given)
        self._data = _GrowingParquet(self.root / "data", data_limit)
        self._about = _GrowingParquet(self.root / "meta" / "episodes", data_limit)
        self._videos = {
            name: VideoJoiner(partial(self._video_file, name), self.layout.fps, video_limit)
            for name in self.layout.cameras
        }
        self._waiting: list[dict[str, Any]] = []

    def abort(self) -> None:
        """Close all files without completing them."""
        self._data.close()
        self._about.close()
        for video in self._videos.values():
            video.close(is_whole=False)

    def _place(self, episode: EncodedEpisode, about: dict[str, Any]) -> None:
        length = episode.table.num_rows
        chunk, file = self._data.place(episode.table.nbytes)
        self._data.write(episode.table)
        row = {
            **about,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": episode.first,
            "dataset_to_index": episode.first + length,
        }
        for name, video in episode.videos.items():
            number, first = self._videos[name].append(video)
            chunk, file = divmod(number, CHUNK)
            row[f"videos/{name}/chunk_index"], row[f"videos/{name}/file_index"] = chunk, file
            row[f"videos/{name}/from_timestamp"] = first / self.layout.fps
            row[f"videos/{name}/to_timestamp"] = (first + length) / self.layout.fps
            video.unlink()
        row |= {f"stats/{name}/{what}": value for name, s in episode.stats.items() for what, value in s.items()}
        self._waiting.append(row)
        if len(self._waiting) == _EPISODES_AT_A_TIME:
            self._flush()

    def _video_file(self, name: str, number: int) -> Path:
        return _parent_made(self.root / "videos" / name / _shared(number, "mp4"))

    def _flush(self) -> None:
        if not self._waiting:
            return
        table = pa.Table.from_pylist(self._waiting, schema=_episode_schema(self.layout))
        chunk, file = self._about.place(table.nbytes)
        for name, number in (("meta/episodes/chunk_index", chunk), ("meta/episodes/file_index", file)):
            table = table.append_column(name, pa.array([number] * len(self._waiting), pa.int64()))
        self._about.write(table)
        self._waiting.clear()

    def _finish(self, meta: Path) -> dict[str, Any]:
        self._flush()
        self._data.close()
        self._about.close()
        for video in self._videos.values():
            video.close()
        pq.write_table(_text_table(self._tasks, "task_index"), meta / "tasks.parquet")
        return {"data_files_size_in_mb": _DATA_MB, "video_files_size_in_mb": _VIDEO_MB}


class _GrowingParquet:
    """Tables in files of limited size, `chunk-000/file-000.parquet` and so on."""

    def __init__(self, root: Path, limit: int) -> None:
        self._root, self._limit, self._files, self._path = root, limit, 0, root
        self._writer: pq.ParquetWriter | None = None

    def place(self, size: int) -> tuple[int, int]:
        """Return the chunk and file number for the next table, given its size [B]."""
        if self._writer is not None and self._path.stat().st_size + size > self._limit:
            self.close()
        return divmod(self._files - (self._writer is not None), CHUNK)

    def write(self, table: pa.Table) -> None:
        """Write a table to the file that `place` named."""
        if self._writer is None:
            self._path = _parent_made(self._root / _shared(self._files, "parquet"))
            self._writer = pq.ParquetWriter(self._path, table.schema, compression="snappy")
            self._files += 1
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the footer, without which nothing can be read; calling it twice is harmless."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def write_json(path: Path, values: Any) -> None:
    """Write a JSON file in ASCII, since readers open it in the machine's encoding."""
    _parent_made(path).write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="ascii")


def write_json_lines(path: Path, rows: Iterable[Any]) -> None:
    """Write a file with a JSON value per line."""
    _parent_made(path).write_text("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows), encoding="ascii")


def _parent_made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _shared(count: int, suffix: str) -> str:
    chunk, number = divmod(count, CHUNK)
    return f"{_SHARED.format(chunk_index=chunk, file_index=number)}.{suffix}"


def _episode_schema(layout: LeRobotLayout) -> pa.Schema:
    whole = ("length", "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index")
    fields = {"episode_index": pa.int64(), "tasks": pa.list_(pa.string()), **dict.fromkeys(whole, pa.int64())}
    for name in layout.cameras:
        fields |= {f"videos/{name}/chunk_index": pa.int64(), f"videos/{name}/file_index": pa.int64()}
        fields |= {f"videos/{name}/from_timestamp": pa.float64(), f"videos/{name}/to_timestamp": pa.float64()}
    # Statistics of values never measured in an episode are null.
    for name in (*(n for n, (dtype, _) in layout.numbers.items() if dtype != TEXT), *layout.cameras):
        values = pa.list_(pa.float64())
        kept = pa.list_(pa.list_(values)) if name in layout.cameras else values
        fields |= {f"stats/{name}/{what}": kept for what in ("min", "max", "mean", "std", *QUANTILES)}
        fields[f"stats/{name}/count"] = pa.list_(pa.int64())
    return pa.schema(list(fields.items()))


def _text_table(texts: list[str], number: str) -> pa.Table:
    # As pandas stores a frame indexed by text, which LeRobot expects.
    index = "__index_level_0__"
    word = {"pandas_type": "unicode", "numpy_type": "object"}
    whole = {"pandas_type": "int64", "numpy_type": "int64"}
    about = {
        "index_columns": [index],
        "column_indexes": [{"name": None, "field_name": None, **word, "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            {"name": number, "field_name": number, **whole, "metadata": None},
            {"name": None, "field_name": index, **word, "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.3",
    }
    table = pa.table({number: pa.array(range(len(texts)), pa.int64()), index: pa.array(texts, pa.string())})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})
