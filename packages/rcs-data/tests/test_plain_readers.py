"""Whatever happens to a dataset, other readers find exactly the rows that it has."""

from __future__ import annotations

import json
import random
import shutil
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import duckdb
import pandas as pd
import pyarrow.dataset
import pytest
from rcs_data import Dataset, DatasetWriter, check, edit
from rcs_data.errors import DatasetError, InvalidSetup

if TYPE_CHECKING:
    from conftest import Record


def rows_of(path: Path) -> dict[str, int]:
    return {episode.id: episode.length for episode in Dataset(path)}


def require_the_same(path: Path, told: str) -> None:
    """Count the rows of each episode by DuckDB, pandas and PyArrow."""
    expected, pattern = rows_of(path), "episodes/*/steps.parquet"
    files = sorted(map(str, path.glob(pattern)))
    assert len(files) == len(expected), told
    index = pd.read_json(path / "episodes.jsonl", lines=True, dtype=False)
    assert (dict(zip(index["id"], index["length"], strict=True)) if len(index) else {}) == expected, told
    if not files:
        return
    counted = f"select episode, count(*), max(step) from '{path / pattern}' group by episode"
    assert {name: n for name, n, last in duckdb.sql(counted).fetchall() if n == last + 1} == expected, told
    frames = pd.concat(pd.read_parquet(file) for file in files)
    assert frames.groupby("episode")["step"].count().to_dict() == expected, told
    assert pyarrow.dataset.dataset(files).count_rows() == sum(expected.values()), told


def step(path: Path, rng: random.Random, record: Record, number: int) -> str:
    """Do one thing to a dataset at random, and return what."""
    ids = list(rows_of(path))
    some = rng.choice(ids) if ids else "none"
    doing = rng.choice(
        ("record", "record", "delete", "keep", "trim", "relabel", "resample", "merge", "undo", "redo", "prune")
    )
    if doing == "record":
        with DatasetWriter.open(path, Dataset(path).info, resume=True) as writer:
            record(writer, f"new-{number}", length=rng.randrange(2, 9), seed=number)
    elif doing == "delete":
        edit.delete(path, [some])
    elif doing == "keep":
        edit.keep(path, rng.sample(ids, rng.randrange(len(ids) + 1)))
    elif doing == "trim":
        edit.trim(path, some, first=1)
    elif doing == "relabel":
        edit.relabel(path, f"push {number}", episodes=rng.choice((None, [some])))
    elif doing == "resample":
        edit.resample(path, Dataset(path).info.frequency * 0.6)
    elif doing == "merge":
        edit.merge([path], path.parent / "merged")
        shutil.rmtree(path)
        (path.parent / "merged").rename(path)
    elif doing == "undo":
        edit.undo(path)
    elif doing == "redo":
        edit.delete(path, [some])
        edit.undo(path)
        edit.delete(path, [some])
    else:
        edit.prune(path)
    return f"{doing} {some}"


def run(path: Path, record: Record, seed: int, steps: int = 8) -> None:
    rng = random.Random(seed)
    told: list[str] = [f"seed {seed}"]
    for number in range(steps):
        try:
            told.append(step(path, rng, record, number))
        except (DatasetError, InvalidSetup) as err:  # nothing to undo, an episode of one row
            told.append(f"refused: {err}"[:60])
        require_the_same(path, "; ".join(told))
    assert check(path, workers=1).is_ok, told


@pytest.mark.parametrize("seed", range(4))
def test_other_readers_count_the_rows_that_a_dataset_has(dataset: Path, record: Record, seed: int) -> None:
    run(dataset, record, seed)


@pytest.mark.slow
def test_other_readers_count_them_after_two_hundred_sequences(dataset: Path, record: Record, tmp_path: Path) -> None:
    for seed in range(100, 300):
        path = tmp_path / "run" / "set"
        shutil.rmtree(path.parent, ignore_errors=True)
        shutil.copytree(dataset, path)
        run(path, record, seed, 6)


def test_each_line_of_the_index_is_an_object_with_its_checksum(dataset: Path) -> None:
    lines: list[dict[str, Any]] = [json.loads(line) for line in (dataset / "episodes.jsonl").read_text().splitlines()]
    assert [line["id"] for line in lines] == ["000000", "000001", "000002"]
    assert all(list(line)[-1] == "checksum" for line in lines)


def test_images_are_unpacked_by_any_program(dataset: Path) -> None:
    for episode in Dataset(dataset):
        with zipfile.ZipFile(episode.path / "frames.zip") as frames:
            assert frames.testzip() is None
            assert {Path(name).suffix for name in frames.namelist()} == {".jpg", ".png"}


def test_null_says_that_there_is_nothing_yet(dataset: Path) -> None:
    steps = pd.concat(pd.read_parquet(file) for file in dataset.glob("episodes/*/steps.parquet"))
    assert steps[steps["step"] == 0]["action/joints"].isna().all()
    assert not steps[steps["step"] > 0].isna().any().any()
