"""Small files of a LeRobot dataset, and Parquet files of limited size."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rcs_data.convert.lerobot_layout import LeRobotLayout
from rcs_data.convert.lerobot_stats import ImageHistogram, Moments, Stats, column_quantiles

CHUNK = 1000
"""Most files per folder."""
MEGABYTE = 1 << 20


@dataclass(frozen=True, kw_only=True)
class EncodedEpisode:
    """An encoded episode, ready to be put in place by a version of the format."""

    index: int
    """Its number among the exported ones."""
    first: int
    """The number of its first frame in the dataset."""
    instruction: str
    """What the robot was asked to do."""
    table: pa.Table
    """Its columns."""
    videos: dict[str, Path]
    """Its videos by column; each must be moved, or joined and removed."""
    stats: dict[str, Stats]
    """Its statistics by column."""
    moments: dict[str, Moments]
    """Moments of its numbers, to merge into the dataset's statistics."""
    histograms: dict[str, ImageHistogram]
    """Histograms of its images, to merge into the dataset's statistics."""


@dataclass
class DatasetStats:
    """The statistics of all episodes together."""

    moments: dict[str, Moments] = field(default_factory=dict[str, Moments])
    histograms: dict[str, ImageHistogram] = field(default_factory=dict[str, ImageHistogram])

    def add(self, episode: EncodedEpisode) -> None:
        """Add the next episode."""
        for name, moments in episode.moments.items():
            self.moments[name] = self.moments[name].merged(moments) if name in self.moments else moments
        for name, histogram in episode.histograms.items():
            self.histograms.setdefault(name, ImageHistogram()).merge(histogram)

    def to_json(self, files: list[Path]) -> dict[str, Stats]:
        """Return the statistics by column, as in `stats.json`.

        Args:
            files: The Parquet files with all columns; quantiles cannot be merged and are computed from these.
        """
        found = {name: moments.stats(column_quantiles(files, name)) for name, moments in self.moments.items()}
        known = {name: stats for name, stats in found.items() if stats is not None}
        return {**known, **{name: histogram.stats() for name, histogram in self.histograms.items()}}


class GrowingParquet:
    """Tables in files of limited size, `chunk-000/file-000.parquet` and so on."""

    def __init__(self, root: Path, limit: int) -> None:
        """Start without a file.

        Args:
            root: The folder of the chunks.
            limit: Size at which a new file begins [B].
        """
        self.files: list[Path] = []
        self._root = root
        self._limit = limit
        self._writer: pq.ParquetWriter | None = None

    def place(self, size: int) -> tuple[int, int]:
        """Return the chunk and file number for the next table, given its size [B]."""
        if self._writer is not None and self.files[-1].stat().st_size + size > self._limit:
            self.close()
        return divmod(len(self.files) - (self._writer is not None), CHUNK)

    def add(self, table: pa.Table) -> tuple[int, int]:
        """Write a table and return its chunk and file number."""
        place = self.place(table.nbytes)
        self.write(table)
        return place

    def write(self, table: pa.Table) -> None:
        """Write a table to the file that `place` named."""
        if self._writer is None:
            path = self._root / numbered(len(self.files), "parquet")
            path.parent.mkdir(parents=True, exist_ok=True)
            self.files.append(path)
            self._writer = pq.ParquetWriter(path, table.schema, compression="snappy")
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the footer, without which nothing can be read; calling it twice is harmless."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def numbered(count: int, suffix: str) -> str:
    """Return the path of a file by its number, `chunk-001/file-000.mp4` for 1000."""
    chunk, number = divmod(count, CHUNK)
    return f"chunk-{chunk:03d}/file-{number:03d}.{suffix}"


def write_json(path: Path, values: Any) -> None:
    """Write a JSON file in ASCII, since readers open it in the machine's encoding."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="ascii")


def write_json_lines(path: Path, rows: Iterable[Any]) -> None:
    """Write a file with a JSON value per line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows), encoding="ascii")


def common_info(layout: LeRobotLayout, robot: str, *, episodes: int, frames: int, tasks: int) -> dict[str, Any]:
    """Return the fields of `info.json` that all versions share.

    Args:
        layout: The columns and videos.
        robot: Name of the robot.
        episodes: Number of episodes.
        frames: Number of frames.
        tasks: Number of instructions.
    """
    return {
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK,
        "fps": layout.fps,
        "splits": {"train": f"0:{episodes}"},
        "features": layout.features(),
    }
