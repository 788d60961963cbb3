"""A reader gives what was written, only what was asked for, and says what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rcs_data import SCHEMA_VERSION, Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.durable import sealed, unsealed


def test_episodes_come_sorted_with_their_facts(dataset: Path) -> None:
    found = Dataset.open(dataset)
    assert [episode.id for episode in found.episodes] == ["000000", "000001", "000002"]
    assert [episode.success for episode in found.episodes] == [True, False, True]
    assert [episode.length for episode in found.episodes] == [6, 7, 8]
    assert found["000001"].outcome == {"failure": "slip"}
    assert len(found) == 3
    assert found[np.int64(1)].id == found[-2].id == "000001"
    assert [episode.id for episode in found[1:]] == ["000001", "000002"]
    with pytest.raises(InvalidSetup, match=r"no episode 1\.5"):
        found[1.5]  # type: ignore[index]


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
    assert episode.steps().column_names == [*(feature.key for feature in episode.info.features), "sim_state"]


def test_what_is_no_image_has_no_frames(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[0]
    with pytest.raises(InvalidSetup, match="not an image"):
        next(episode.frames("reward"))
    with pytest.raises(InvalidSetup, match=r"Known: action/index, .*observation/joints"):
        episode.column("speed")
    with pytest.raises(InvalidSetup, match="no episode 'x'"):
        Dataset.open(dataset)["x"]


def test_what_an_index_knows_is_not_read_and_replaces_what_was_recorded(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[1]
    known = msgspec.structs.replace(episode.entry, success=True, instruction="push")
    listed = EpisodeRecord(dataset / "nowhere", episode.info, known)
    facts = (listed.id, listed.length, listed.seed, listed.success, listed.instruction)
    assert facts == ("000001", 7, 1, True, "push")
    relabelled = EpisodeRecord(episode.path, episode.info, known)
    assert relabelled.about == {**episode.about, "instruction": "push"}
    assert len(relabelled.column("reward")) == 7


def test_a_missing_dataset_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"episodes\.jsonl is missing"):
        Dataset.open(tmp_path)


def test_a_damaged_episode_does_not_keep_the_others_from_being_read(dataset: Path) -> None:
    (dataset / "episodes/000000/episode.json").write_text("{")
    (dataset / "episodes/000001/steps.parquet").unlink()
    found = Dataset.open(dataset)
    with pytest.raises(CorruptEpisode, match="damaged"):
        _ = found.episodes[0].outcome
    with pytest.raises(CorruptEpisode, match=r"Cannot read .*steps\.parquet"):
        found.episodes[1].column("reward")
    assert found.episodes[2].column("reward").shape == (8,)


def test_a_changed_verdict_is_seen(dataset: Path) -> None:
    path = dataset / "episodes/000001/episode.json"
    path.write_text(path.read_text().replace('"success": false', '"success": true'))
    with pytest.raises(CorruptEpisode, match="checksum"):
        _ = Dataset.open(dataset)["000001"].about


def test_another_layout_is_refused(dataset: Path) -> None:
    path = dataset / "episodes/000001/episode.json"
    values = unsealed(path.read_bytes(), path)
    path.write_bytes(sealed({**values, "schema_version": SCHEMA_VERSION + 1}))
    with pytest.raises(DatasetError, match="Update this library"):
        _ = Dataset.open(dataset)["000001"].about
    path = dataset / "dataset.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), "schema_version": SCHEMA_VERSION - 1}))
    with pytest.raises(DatasetError, match="Record it anew"):
        Dataset.open(dataset)


def test_the_files_are_plain_json(dataset: Path) -> None:
    about = json.loads((dataset / "episodes/000001/episode.json").read_text())
    assert about["seed"] == 1
    assert set(about["sha256"]) == {"steps.parquet", "frames.zip"}


def test_a_held_value_is_in_every_row(tmp_path: Path) -> None:
    matrix = Feature(key="observation/matrix", shape=(2, 2), dtype="float64", encoding="held")
    info = DatasetInfo(frequency=10.0, features=(matrix,), setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "dataset", info) as writer, writer.episode("a", seed=0) as episode:
        for value in (1, 1, 1, 2):
            episode.add({matrix.key: np.full((2, 2), float(value))})
        episode.finish(None)
    (found,) = Dataset.open(tmp_path / "dataset")
    held = found.steps([matrix.key]).column(matrix.key)
    assert held.null_count == 0
    assert [value[3] for value in held.to_pylist()] == [1, 1, 1, 2]


def test_a_dataset_is_a_collection_of_its_episodes(dataset: Path) -> None:
    opened = Dataset.open(dataset)
    assert list(opened) == list(opened.episodes)
    assert len(list(opened)) == len(opened) == 3
    assert all(episode in opened and episode.id in opened and opened[episode.id] is episode for episode in opened)
    assert "no such" not in opened
    assert 0 not in opened


def test_the_usual_case_is_one_class_deep(dataset: Path) -> None:
    opened = Dataset(str(dataset))
    np.testing.assert_array_equal(opened[2]["observation/joints"], opened["000002"].column("observation/joints"))
    assert opened[-1] is opened.episodes[-1]
    window = opened.windows(history=2, actions=3, cameras=())[0]
    assert (window["state"].shape, window["actions"].shape) == ((2, 4), (3, 3))
