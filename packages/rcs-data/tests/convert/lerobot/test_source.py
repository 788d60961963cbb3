"""Patterns of paths that a LeRobotDataset names are filled, and lead nowhere else; what is not a file is refused."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from rcs_data.convert.lerobot.source import _opened, filled
from rcs_data.errors import CorruptEpisode


def test_a_pipe_in_the_place_of_a_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "tasks.parquet")
    with pytest.raises(CorruptEpisode, match="not a file"), _opened(tmp_path / "tasks.parquet"):
        pass


@pytest.mark.parametrize(
    "pattern",
    [
        "../{video_key}.mp4",
        "/etc/{video_key}",
        "{video_key.__class__}",
        "{episode_index:0999999999d}",
        "{other}",
        "",
        3,
    ],
)
def test_a_pattern_of_paths_stays_in_its_folder(pattern: Any) -> None:
    with pytest.raises(CorruptEpisode, match="pattern"):
        filled(pattern, {"video_key": "wrist", "episode_index": 3})


def test_a_pattern_is_filled_as_its_format_has_it() -> None:
    values = {"video_key": "a.b", "episode_index": 3, "episode_chunk": 0}
    pattern = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    assert str(filled(pattern, values)) == pattern.format(**values)
    with pytest.raises(CorruptEpisode):
        filled("{video_key}", {"video_key": ".."})
