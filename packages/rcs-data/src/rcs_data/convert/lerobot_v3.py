"""LeRobotDataset v3.0 on disk: many episodes in each Parquet file and video. lerobot 0.4 and newer read it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rcs_data.convert.lerobot_files import (
    CHUNK,
    MEGABYTE,
    DatasetStats,
    EncodedEpisode,
    GrowingParquet,
    common_info,
    numbered,
    write_json,
)
from rcs_data.convert.lerobot_layout import LeRobotLayout
from rcs_data.convert.lerobot_stats import QUANTILES
from rcs_data.convert.video import VideoJoiner

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_DATA_MB, _VIDEO_MB = 100, 200
_EPISODES_AT_A_TIME = 100


class V3Writer:
    """Writes encoded episodes one after the other."""

    def __init__(
        self,
        root: Path,
        layout: LeRobotLayout,
        robot: str,
        tasks: list[str],
        *,
        data_limit: int = _DATA_MB * MEGABYTE,
        video_limit: int = _VIDEO_MB * MEGABYTE,
    ) -> None:
        """Start a dataset.

        Args:
            root: Its folder.
            layout: The columns and videos.
            robot: Name of the robot.
            tasks: All instructions.
            data_limit: Size at which a new Parquet file begins [B].
            video_limit: Size at which a new video begins [B].
        """
        self._root = root
        self._layout = layout
        self._robot = robot
        self._tasks = tasks
        self._total = DatasetStats()
        self._data = GrowingParquet(root / "data", data_limit)
        self._about = GrowingParquet(root / "meta" / "episodes", data_limit)
        self._videos = {name: _GrowingVideo(root / "videos" / name, layout.fps, video_limit) for name in layout.cameras}
        self._waiting: list[dict[str, Any]] = []
        self._episodes = 0
        self._frames = 0

    def add(self, episode: EncodedEpisode) -> None:
        """Write the next episode."""
        length = episode.table.num_rows
        chunk, file = self._data.add(episode.table)
        row: dict[str, Any] = {
            "episode_index": episode.index,
            "tasks": [episode.instruction],
            "length": length,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": episode.first,
            "dataset_to_index": episode.first + length,
        }
        for name, video in episode.videos.items():
            chunk, file, first = self._videos[name].add(video)
            row[f"videos/{name}/chunk_index"], row[f"videos/{name}/file_index"] = chunk, file
            row[f"videos/{name}/from_timestamp"] = first / self._layout.fps
            row[f"videos/{name}/to_timestamp"] = (first + length) / self._layout.fps
            video.unlink()
        row |= {f"stats/{name}/{what}": value for name, s in episode.stats.items() for what, value in s.items()}
        self._waiting.append(row)
        self._total.add(episode)
        self._episodes += 1
        self._frames += length
        if len(self._waiting) == _EPISODES_AT_A_TIME:
            self._flush()

    def finish(self) -> None:
        """Close all files and write those that need all episodes.

        Raises:
            DatasetError: A video has wrong frames.
        """
        self._flush()
        self._data.close()
        self._about.close()
        for video in self._videos.values():
            video.close()
        common = common_info(
            self._layout, self._robot, episodes=self._episodes, frames=self._frames, tasks=len(self._tasks)
        )
        info = {
            "codebase_version": "v3.0",
            **common,
            "data_files_size_in_mb": _DATA_MB,
            "video_files_size_in_mb": _VIDEO_MB,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if self._layout.cameras else None,
        }
        meta = self._root / "meta"
        write_json(meta / "info.json", info)
        write_json(meta / "stats.json", self._total.to_json(self._data.files))
        pq.write_table(_task_table(self._tasks), meta / "tasks.parquet")

    def abort(self) -> None:
        """Close all files without completing them."""
        self._data.close()
        self._about.close()
        for video in self._videos.values():
            video.abort()

    def _flush(self) -> None:
        if not self._waiting:
            return
        table = pa.Table.from_pylist(self._waiting, schema=_episode_schema(self._layout))
        chunk, file = self._about.place(table.nbytes)
        for name, number in (("meta/episodes/chunk_index", chunk), ("meta/episodes/file_index", file)):
            table = table.append_column(name, pa.array([number] * len(self._waiting), pa.int64()))
        self._about.write(table)
        self._waiting.clear()


class _GrowingVideo:
    """Joins videos of episodes to files of limited size."""

    def __init__(self, root: Path, fps: int, limit: int) -> None:
        self._root = root
        self._fps = fps
        self._limit = limit
        self._files = 0
        self._joiner: VideoJoiner | None = None

    def add(self, path: Path) -> tuple[int, int, int]:
        """Append a video and return its chunk number, file number and first frame."""
        if self._joiner is not None:
            is_full = self._joiner.size + path.stat().st_size > self._limit
            if is_full or not self._joiner.takes(path):
                self.close()
        if self._joiner is None:
            target = self._root / numbered(self._files, "mp4")
            target.parent.mkdir(parents=True, exist_ok=True)
            self._joiner = VideoJoiner(target, self._fps)
            self._files += 1
        first = self._joiner.append(path)
        return *divmod(self._files - 1, CHUNK), first

    def close(self) -> None:
        """Complete the open file."""
        if self._joiner is not None:
            self._joiner.close()
            self._joiner = None

    def abort(self) -> None:
        """Close the open file without completing it."""
        if self._joiner is not None:
            self._joiner.abort()
            self._joiner = None


def _episode_schema(layout: LeRobotLayout) -> pa.Schema:
    fields = {
        "episode_index": pa.int64(),
        "tasks": pa.list_(pa.string()),
        **dict.fromkeys(
            ("length", "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index"), pa.int64()
        ),
    }
    for name in layout.cameras:
        fields |= {f"videos/{name}/chunk_index": pa.int64(), f"videos/{name}/file_index": pa.int64()}
        fields |= {f"videos/{name}/from_timestamp": pa.float64(), f"videos/{name}/to_timestamp": pa.float64()}
    # Statistics of values never measured in an episode are null.
    for name in (*layout.numbers, *layout.cameras):
        values = pa.list_(pa.float64())
        kept = pa.list_(pa.list_(values)) if name in layout.cameras else values
        fields |= {f"stats/{name}/{what}": kept for what in ("min", "max", "mean", "std", *QUANTILES)}
        fields[f"stats/{name}/count"] = pa.list_(pa.int64())
    return pa.schema(list(fields.items()))


def _task_table(tasks: list[str]) -> pa.Table:
    # As pandas stores a frame indexed by instruction, which LeRobot expects.
    index = "__index_level_0__"
    word = {"pandas_type": "unicode", "numpy_type": "object"}
    about = {
        "index_columns": [index],
        "column_indexes": [{"name": None, "field_name": None, **word, "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            {
                "name": "task_index",
                "field_name": "task_index",
                "pandas_type": "int64",
                "numpy_type": "int64",
                "metadata": None,
            },
            {"name": None, "field_name": index, **word, "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.3",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: pa.array(tasks, pa.string())})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})
