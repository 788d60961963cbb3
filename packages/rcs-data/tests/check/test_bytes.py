"""Whatever byte is changed, the check finds it, in the right episode, and blames no other."""

from __future__ import annotations

import hashlib
import random
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset, DatasetWriter, Feature, check
from rcs_data.files.durable import sealed, unsealed
from rcs_data.files.layout import OPEN_FOLDER, new_trash

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows

STATE = 5  # the sim_state_size of make_info

FILES = ("steps.parquet", "frames.zip", "episode.json")


def test_a_whole_dataset_has_no_findings(dataset: Path) -> None:
    report = check(dataset)
    assert not report.findings, str(report)
    assert (report.episodes, report.rows, report.frames) == (3, 21, 42)
    assert report.summary == "3 episodes, 21 rows, 42 images checked: no damage"
    assert check(dataset, depth="rows").frames == 0


@pytest.mark.parametrize("file", FILES)
def test_a_changed_byte_anywhere_is_found_where_it_is(dataset: Path, file: str) -> None:
    path = dataset / "episodes/000001" / file
    data = path.read_bytes()
    rng = random.Random(file)
    for _ in range(25):
        place = rng.randrange(len(data))
        path.write_bytes(data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :])
        findings = check(dataset).findings
        assert findings, f"byte {place}"
        assert {(f.episode, f.file) for f in findings} == {("000001", f"episodes/000001/{file}")}


@pytest.mark.parametrize("file", FILES)
def test_a_file_that_was_cut_or_removed_is_found(dataset: Path, file: str) -> None:
    path = dataset / "episodes/000001" / file
    path.write_bytes(path.read_bytes()[:-5])
    assert {f.episode for f in check(dataset).findings} == {"000001"}
    path.unlink()
    assert {(f.episode, f.file) for f in check(dataset).findings} == {("000001", f"episodes/000001/{file}")}


def test_a_group_without_rows_is_no_error_of_the_check(dataset: Path) -> None:
    about = dataset / "episodes/000001/episode.json"
    values = unsealed(about.read_bytes(), about)
    path = about.with_name("steps.parquet")
    table = pq.read_table(path)
    with pq.ParquetWriter(path, table.schema) as writer:
        for part in (table.slice(0, 0), table):
            writer.write_table(part)
    values["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    about.write_bytes(sealed(values))
    assert {finding.episode for finding in check(dataset).damage} <= {"000001"}


def test_a_broken_image_is_located_by_row(dataset: Path) -> None:
    episode = Dataset.open(dataset)["000001"]
    jpeg = list(episode.encoded_frames("observation/frames/wrist/rgb"))[4]
    path = episode.path / "frames.zip"
    data = path.read_bytes()
    start = data.index(jpeg)
    path.write_bytes(data[:start] + b"\0\0" + data[start + 2 :])
    altered, broken = check(dataset).findings
    assert (altered.kind, broken.kind, broken.rows) == ("altered", "image", (4, 4))
    assert "observation/frames/wrist/rgb" in broken.message
    assert str(broken).startswith("damage: episodes/000001/frames.zip, row 4: ")


def test_files_of_another_episode_are_found(dataset: Path) -> None:
    shutil.copy(dataset / "episodes/000000/steps.parquet", dataset / "episodes/000002/steps.parquet")
    assert {finding.episode for finding in check(dataset).findings} == {"000002"}


def test_notes_may_be_missing_in_any_step(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    note = Feature(key="notes/latency", shape=(), dtype="float64")
    info = replace(make_info(), features=(*make_info().features, note))
    with DatasetWriter.open(tmp_path / "a", info) as writer, writer.episode("a", seed=0) as episode:
        for row in make_rows(5):
            episode.add({**row, "notes/latency": np.nan}, np.zeros(STATE))
        episode.finish(True)
    assert [finding.kind for finding in check(tmp_path / "a").findings if finding.kind == "not_finite"] == []


def test_values_that_are_not_finite_are_located(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    rows = make_rows(8)
    rows[3]["observation/joints"][1] = np.nan
    rows[5]["observation/joints"][0] = np.inf
    with DatasetWriter.open(tmp_path, make_info()) as writer, writer.episode("a", seed=0) as episode:
        for row in rows:
            episode.add(row, np.zeros(STATE))
        episode.finish(True)
    (finding,) = check(tmp_path).findings
    assert (finding.severity, finding.kind, finding.rows) == ("warning", "not_finite", (3, 5))
    assert finding.message == "'observation/joints' is not finite in 2 rows"


def test_loose_ends_are_found_unless_a_writer_is_at_them(
    dataset: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(dataset, make_info(images=True), resume=True) as writer:
        writer.episode("late", seed=0).add(make_rows(1, images=True)[0], np.zeros(STATE))
        assert not check(dataset).findings
    new_trash(dataset, "gone").mkdir(parents=True)
    (dataset / "episodes/empty").mkdir()
    found = {(finding.severity, finding.kind, finding.episode) for finding in check(dataset).findings}
    assert found == {("warning", "left_open", "late"), ("warning", "left_over", None), ("warning", "unlisted", None)}
    assert (dataset / OPEN_FOLDER / "late").exists(), "a check changes nothing"


def test_a_damaged_description_is_the_only_finding(dataset: Path) -> None:
    path = dataset / "dataset.json"
    path.write_bytes(path.read_bytes()[:-20])
    (finding,) = check(dataset).findings
    assert (finding.episode, finding.file) == (None, "dataset.json")


def test_an_episode_of_a_newer_layout_is_a_finding(dataset: Path) -> None:
    path = dataset / "episodes/000001/episode.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), "schema_version": 99}))
    (finding,) = check(dataset).findings
    assert "Update this library to read it" in finding.message
