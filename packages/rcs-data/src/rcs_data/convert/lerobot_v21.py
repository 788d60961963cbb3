"""LeRobotDataset v2.1 on disk: a Parquet file and videos per episode. openpi, lerobot 0.3 and GR00T read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from rcs_data.convert.lerobot_files import (
    CHUNK,
    DatasetStats,
    EncodedEpisode,
    common_info,
    write_json,
    write_json_lines,
)
from rcs_data.convert.lerobot_layout import LeRobotLayout

DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"


class V21Writer:
    """Writes encoded episodes one after the other."""

    def __init__(self, root: Path, layout: LeRobotLayout, robot: str, tasks: list[str]) -> None:
        """Start a dataset.

        Args:
            root: Its folder.
            layout: The columns and videos.
            robot: Name of the robot.
            tasks: All instructions.
        """
        self._root = root
        self._layout = layout
        self._robot = robot
        self._tasks = tasks
        self._total = DatasetStats()
        self._episodes: list[dict[str, Any]] = []
        self._stats: list[dict[str, Any]] = []
        self._files: list[Path] = []

    def add(self, episode: EncodedEpisode) -> None:
        """Write the next episode."""
        where = {"episode_chunk": episode.index // CHUNK, "episode_index": episode.index}
        path = self._root / DATA_PATH.format(**where)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(episode.table, path, compression="snappy")
        self._files.append(path)
        for name, video in episode.videos.items():
            target = self._root / VIDEO_PATH.format(**where, video_key=name)
            target.parent.mkdir(parents=True, exist_ok=True)
            video.rename(target)
        self._total.add(episode)
        length = episode.table.num_rows
        self._episodes.append({"episode_index": episode.index, "tasks": [episode.instruction], "length": length})
        self._stats.append({"episode_index": episode.index, "stats": episode.stats})

    def finish(self) -> None:
        """Write the files that need all episodes."""
        meta = self._root / "meta"
        frames = sum(episode["length"] for episode in self._episodes)
        count = len(self._episodes)
        common = common_info(self._layout, self._robot, episodes=count, frames=frames, tasks=len(self._tasks))
        info = {
            "codebase_version": "v2.1",
            **common,
            "total_videos": count * len(self._layout.cameras),
            "total_chunks": -(-count // CHUNK),
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if self._layout.cameras else None,
        }
        write_json(meta / "info.json", info)
        # v2.0 has this instead of statistics per episode, and some readers of v2.1 still need it.
        write_json(meta / "stats.json", self._total.to_json(self._files))
        write_json_lines(meta / "tasks.jsonl", ({"task_index": i, "task": t} for i, t in enumerate(self._tasks)))
        write_json_lines(meta / "episodes.jsonl", self._episodes)
        write_json_lines(meta / "episodes_stats.jsonl", self._stats)

    def abort(self) -> None:
        """Do nothing, since no file stays open."""
