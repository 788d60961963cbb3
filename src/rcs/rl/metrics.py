"""Figures of a run over its steps, as lines of JSON."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping
from pathlib import Path

from rcs_data.files.closing import Closing
from rcs_data.files.durable import disk_errors, write_all, write_file
from rcs_data.files.json_file import parsed_json
from rcs_data.options import Natural, Record

from rcs.errors import CorruptEpisode, InvalidSetup

METRICS = "metrics.jsonl"

EPISODES, SUCCESSES, JUDGED = "evaluation/episodes", "evaluation/successes", "evaluation/judged"
RATE, REWARD, LENGTH = "evaluation/success_rate", "evaluation/reward", "evaluation/length"
SPEED = "time/steps_per_s"


class Row(Record):
    """Figures of one moment of a run."""

    steps: Natural
    """Environment steps before, of all copies together."""
    seconds: float
    """Duration of the training until here [s]."""
    time: float
    """Seconds since 1970, by the wall clock."""
    figures: Mapping[str, float]
    """Figures by names such as `train/loss`; those of updates and of training's episodes are Stable-Baselines3's."""

    def line(self) -> bytes:
        """Return the row as a line of JSON."""
        return (json.dumps(self.to_json()) + "\n").encode()


def read_metrics(run: Path) -> list[Row]:
    """Return the rows of a run, oldest first, up to a damaged one, which a kill leaves at the end."""
    rows: list[Row] = []
    try:
        lines = (run / METRICS).read_bytes().split(b"\n")[:-1]
    except FileNotFoundError:
        return rows
    for line in lines:
        try:
            rows.append(Row.from_json(parsed_json(line, run / METRICS)))
        except (CorruptEpisode, InvalidSetup, TypeError):
            break
    return rows


class Metrics(Closing):
    """Writes the figures of a run. After a kill, rows that will be repeated are removed first."""

    def __init__(self, run: Path, *, after: int) -> None:
        """Continue the figures of a run.

        Args:
            run: Its folder.
            after: The step from which training continues; later rows are removed. -1 removes all.

        Raises:
            DatasetError: The disk fails.
        """
        rows = [row for row in read_metrics(run) if row.steps <= after]
        self._path = path = run / METRICS
        with disk_errors("write figures", path):
            write_file(path, b"".join(row.line() for row in rows))
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND)

    def add(self, steps: int, seconds: float, figures: Mapping[str, float]) -> None:
        """Add a row; figures that are not finite are left out.

        Raises:
            DatasetError: The disk fails.
        """
        kept = {name: value for name, value in figures.items() if math.isfinite(value)}
        row = Row(steps=steps, seconds=round(seconds, 3), time=round(time.time(), 3), figures=kept)
        with disk_errors("write figures", self._path):
            write_all(self._file, row.line())

    def sync(self) -> None:
        """Bring all rows to the disk, before a checkpoint that counts on them."""
        with disk_errors("write figures", self._path):
            os.fsync(self._file)

    def close(self) -> None:
        """Close the files. Closing twice is harmless."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
