"""Whatever byte of a dataset changes, wherever a file ends: the check names the episode, and repair mends it."""

from __future__ import annotations

import logging
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, check, edit
from rcs_data.check.repair import repair
from rcs_data.lock import LOCK_FILES

COUNT = 4
LONG = 40


@pytest.fixture(scope="module")
def edited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three generations: cameras with and without loss, depth, simulation states, a trimmed episode."""
    path = tmp_path_factory.mktemp("edited") / "set"
    make(path)
    edit.trim(path, "000002", first=1, last=4)
    edit.delete(path, ["000003"])
    (path / "view").mkdir()
    (path / "view/index.html").write_text("<p>a page</p>")
    (path / "report.html").write_text("<p>a report</p>")
    return path


def make(path: Path) -> None:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="observation/frames/wrist/rgb", shape=(8, 12, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="observation/frames/side/rgb", shape=(8, 12, 3), dtype="uint8", encoding="lossless"),
        Feature(key="observation/frames/side/depth", shape=(8, 12), dtype="uint16", encoding="depth"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
        Feature(key="flags/frames/side", shape=(), dtype="uint8"),
    )
    info = DatasetInfo(frequency=30, features=features, setup={"robot": "a toy"}, instruction="look", sim_state_size=3)
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for number in range(COUNT):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(LONG if number == 1 else 6):
                    joints = np.full(2, 0.01 * i)
                    row = {
                        "observation/joints": joints,
                        "observation/frames/wrist/rgb": rng.integers(0, 256, (8, 12, 3), np.uint8),
                        "observation/frames/side/rgb": rng.integers(0, 256, (8, 12, 3), np.uint8),
                        "observation/frames/side/depth": rng.integers(1, 65536, (8, 12), np.uint16),
                        "time/monotonic": 3 + i / 30,
                    }
                    episode.add(row if i == 0 else {**row, "action/joints": joints}, np.full(3, float(i)))
                episode.finish(number != 2, {"failure": None})


def files_of(path: Path) -> list[Path]:
    return sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())


def copy_of(path: Path, target: Path, *, keep_links: bool) -> Path:
    """A copy in which a file that two generations share is one file again, or two."""
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(path, target)
    if keep_links:
        first: dict[int, Path] = {}
        for file in files_of(path):
            inode = (path / file).stat().st_ino
            if inode in first:
                (target / file).unlink()
                (target / file).hardlink_to(target / first[inode])
            first.setdefault(inode, file)
    return target


def contents(dataset: Dataset) -> dict[str, tuple[str, bytes]]:
    return {e.id: (e.content_hash, (e.path / "steps.parquet").read_bytes()) for e in dataset.episodes}


def load_fully(dataset: Dataset, but: str | None) -> None:
    for episode in dataset.episodes:
        if episode.id != but:
            for feature in dataset.info.features:
                assert len(episode.column(feature.key)) == episode.length
            assert len(episode.sim_state()) == episode.length


def require_found_and_mended(path: Path, file: Path, original: Dataset, told: str) -> Dataset:
    """Check a dataset in which one file is damaged, read all the rest, repair it; return what is there then."""
    name = file.parts[-2] if "episodes" in file.parts else None
    findings = check(path).damage
    assert {finding.episode for finding in findings} == {name}, told
    load_fully(Dataset.open(path), name)
    done = repair(path)
    report = check(path)
    assert report.is_ok, f"{told}: {done}: {report}"
    mended = Dataset.open(path)
    load_fully(mended, None)
    before, after = contents(original), contents(mended)
    assert {k: v for k, v in after.items() if k != name} == {k: v for k, v in before.items() if k != name}, told
    assert not repair(path).mendings, f"{told}: a second repair has nothing to do"
    return mended


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR)  # that dataset.json was read from its copy is told each time


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), bit=st.integers(0, 7), keep_links=st.booleans())
def test_one_flipped_bit_anywhere_is_found(edited: Path, tmp_path: Path, seed: int, bit: int, keep_links: bool) -> None:
    rng = random.Random(seed)
    files = [file for file in files_of(edited) if is_read(file)]
    file = rng.choice(files)
    path = copy_of(edited, tmp_path / "set", keep_links=keep_links)
    data = bytearray((path / file).read_bytes())
    place = rng.randrange(len(data))
    data[place] ^= 1 << bit
    (path / file).write_bytes(bytes(data))
    original = Dataset.open(edited)
    require_found_and_mended(path, file, original, f"{file}, byte {place}, bit {bit}")


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), how=st.sampled_from(["cut", "gone", "empty", "scribbled", "replaced byte"]))
def test_a_file_that_is_cut_gone_or_scribbled_over_is_found_and_what_is_left_kept(
    edited: Path, tmp_path: Path, seed: int, how: str
) -> None:
    rng = random.Random(seed)
    file = rng.choice([file for file in files_of(edited) if is_read(file)])
    path = copy_of(edited, tmp_path / "set", keep_links=rng.random() < 0.5)
    data = (path / file).read_bytes()
    place = rng.randrange(len(data))
    scribble = bytes(byte ^ rng.randrange(1, 256) for byte in data[place : place + 40])
    damaged = {
        "cut": data[:place],
        "empty": b"",
        "scribbled": data[:place] + scribble + data[place + len(scribble) :],
        "replaced byte": data[:place] + bytes([(data[place] + rng.randrange(1, 256)) % 256]) + data[place + 1 :],
    }
    if how == "gone":
        (path / file).unlink()
    else:
        (path / file).write_bytes(damaged[how])
    require_found_and_mended(path, file, Dataset.open(edited), f"{file} {how} at {place}")
    quarantine = path / "quarantine"
    if "episodes" in file.parts and how != "gone" and quarantine.exists():
        kept = [found.read_bytes() for found in quarantine.rglob(file.name)]
        assert damaged[how] in kept or not kept, "what was there is kept as it was"


def test_what_nothing_reads_may_change(edited: Path, tmp_path: Path) -> None:
    path = copy_of(edited, tmp_path / "set", keep_links=True)
    strangers = [file for file in files_of(path) if not is_read(file)]
    assert len(strangers) == 4
    for file in strangers:
        (path / file).write_bytes(b"anything")
    assert not check(path).findings


def is_read(file: Path) -> bool:
    return file.parts[0] != "view" and file.name not in (*LOCK_FILES, "report.html")
