"""A reader gives what was written, only what was asked for, and says what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcs.data import SCHEMA_VERSION, Dataset
from rcs.data.durable import sealed, unsealed
from rcs.errors import CorruptEpisode, DatasetError, InvalidSetup


def test_episodes_come_sorted_with_their_facts(dataset: Path) -> None:
    found = Dataset.open(dataset)
    assert [episode.id for episode in found.episodes] == ["000000", "000001", "000002"]
    assert [episode.success for episode in found.episodes] == [True, False, True]
    assert [episode.length for episode in found.episodes] == [6, 7, 8]
    assert found["000001"].outcome == {"failure": "slip"}
    assert len(found) == 3


def test_frames_come_one_by_one(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[1]
    frames = list(episode.frames("observation/frames/wrist/rgb"))
    assert len(frames) == episode.length
    np.testing.assert_array_equal(np.stack(frames), episode.column("observation/frames/wrist/rgb"))
    jpegs = list(episode.encoded_frames("observation/frames/wrist/rgb"))
    assert all(jpeg.startswith(b"\xff\xd8") for jpeg in jpegs)


def test_only_the_columns_asked_for_are_read(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[0]
    assert episode.steps(["reward", "terminated"]).column_names == ["reward", "terminated"]
    assert episode.steps().column_names == [feature.key for feature in episode.info.features]


def test_what_is_no_image_has_no_frames(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[0]
    with pytest.raises(InvalidSetup, match="no image"):
        next(episode.frames("reward"))
    with pytest.raises(InvalidSetup, match="Known: observation/joints"):
        episode.column("speed")
    with pytest.raises(InvalidSetup, match="no episode 'x'"):
        Dataset.open(dataset)["x"]


def test_a_missing_dataset_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"dataset\.json is missing"):
        Dataset.open(tmp_path)


def test_a_damaged_episode_does_not_keep_the_others_from_being_read(dataset: Path) -> None:
    (dataset / "episodes/000000/episode.json").write_text("{")
    (dataset / "episodes/000001/steps.parquet").unlink()
    found = Dataset.open(dataset)
    with pytest.raises(CorruptEpisode, match="damaged"):
        _ = found.episodes[0].success
    with pytest.raises(CorruptEpisode, match=r"steps\.parquet does not read"):
        found.episodes[1].column("reward")
    assert found.episodes[2].column("reward").shape == (8,)


def test_a_changed_verdict_is_seen(dataset: Path) -> None:
    path = dataset / "episodes/000001/episode.json"
    path.write_text(path.read_text().replace('"success": false', '"success": true'))
    with pytest.raises(CorruptEpisode, match="checksum"):
        _ = Dataset.open(dataset)["000001"].success


def test_a_newer_layout_is_refused(dataset: Path) -> None:
    for path in (dataset / "episodes/000001/episode.json", dataset / "dataset.json"):
        values = unsealed(path.read_bytes(), path)
        path.write_bytes(sealed({**values, "schema_version": SCHEMA_VERSION + 1}))
        with pytest.raises(DatasetError, match="newer version of this library; update"):
            _ = Dataset.open(dataset)["000001"].success


def test_the_files_are_plain_json(dataset: Path) -> None:
    about = json.loads((dataset / "episodes/000001/episode.json").read_text())
    assert about["seed"] == 1
    assert set(about["sha256"]) == {"steps.parquet", "sim_state.parquet"}
