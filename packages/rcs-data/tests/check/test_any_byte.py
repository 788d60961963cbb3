"""Whatever byte of a dataset changes, wherever a file ends: nothing wrong is read in silence, the check names the
episode, and repair mends it."""

from __future__ import annotations

import random
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature, check, edit
from rcs_data.check.repair import repair
from rcs_data.errors import CorruptEpisode
from rcs_data.files.layout import INDEX_FILE
from rcs_data.files.lock import LOCK_FILES

COUNT = 4
LONG = 40
FLIPS = [12, pytest.param(600, marks=pytest.mark.slow)]


@pytest.fixture(scope="module")
def edited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset that was edited twice: cameras with and without loss, depth, simulation states, a trimmed episode."""
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


def flip_a_bit(file: Path, rng: random.Random) -> str:
    """Change a bit of a file, and return which."""
    data = bytearray(file.read_bytes())
    place, bit = rng.randrange(len(data)), rng.randrange(8)
    data[place] ^= 1 << bit
    file.write_bytes(data)
    return f"{file}, byte {place}, bit {bit}"


def files_of(path: Path) -> list[Path]:
    return sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())


def copy_of(path: Path, target: Path) -> Path:
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(path, target)
    return target


def contents(dataset: Dataset) -> dict[str, tuple[str, bytes]]:
    return {e.id: (e.content_hash, (e.path / "steps.parquet").read_bytes()) for e in dataset.episodes}


def part_of(episode: EpisodeRecord, name: str) -> object:
    if name == "about":
        return episode.about
    values = episode.sim_state() if name == "sim_state" else episode.column(name)
    return values.dtype, values.shape, values.tobytes()


def require_same_or_told(dataset: Dataset, original: Dataset, damaged: str | None, told: str) -> None:
    """Read everything: what differs from what was written is an error, and only in the damaged episode."""
    for episode in dataset.episodes:
        for name in ("about", "sim_state", *(feature.key for feature in original.info.features)):
            try:
                found = part_of(episode, name)
            except CorruptEpisode:
                assert episode.id == damaged, f"{told}: {name} of {episode.id}"
            else:
                assert found == part_of(original[episode.id], name), f"{told}: {name} of {episode.id}, in silence"


def require_found_and_mended(path: Path, file: Path, original: Dataset, told: str) -> None:
    """Check a dataset in which one file is damaged, read all the rest, repair it, and look at what is there then."""
    folder = file.parts[1] if file.parts[0] in ("episodes", "former") else None
    name = None if folder is None else folder.partition("@")[0]
    findings = check(path).findings
    assert {finding.episode for finding in findings if finding.severity == "damage"} == {name}, told
    if file.name != INDEX_FILE:
        require_same_or_told(Dataset.open(path), original, name, told)
    done = repair(path)
    report = check(path)
    assert report.is_ok, f"{told}: {done}: {report}"
    mended = Dataset.open(path)
    require_same_or_told(mended, original, None, told)
    before, after = contents(original), contents(mended)
    assert {k: v for k, v in after.items() if k != name} == {k: v for k, v in before.items() if k != name}, told
    assert not repair(path), f"{told}: a second repair has nothing to do"


@pytest.mark.parametrize("flips", FLIPS)
def test_one_flipped_bit_anywhere_is_found_put_aside_and_never_read_in_silence(
    edited: Path, tmp_path: Path, flips: int
) -> None:
    original, files = Dataset.open(edited), [file for file in files_of(edited) if is_read(file)]
    files.remove(Path(INDEX_FILE))
    for seed in range(flips):
        rng = random.Random(seed)
        file = rng.choice(files)
        path = copy_of(edited, tmp_path / "set")
        told = flip_a_bit(path / file, rng)
        require_found_and_mended(path, file, original, told)


@pytest.mark.parametrize("flips", FLIPS)
def test_one_flipped_bit_of_the_index_costs_no_episode(edited: Path, tmp_path: Path, flips: int) -> None:
    original = Dataset.open(edited)
    for seed in range(flips):
        path = copy_of(edited, tmp_path / "set")
        told = flip_a_bit(path / INDEX_FILE, random.Random(seed))
        with suppress(CorruptEpisode):
            require_same_or_told(Dataset.open(path), original, None, told)
        assert check(path).findings, told
        repair(path)
        assert check(path).is_ok, told
        mended = Dataset.open(path)
        require_same_or_told(mended, original, None, told)
        assert [episode.id for episode in mended] == [episode.id for episode in original], told
        assert not repair(path), told


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), how=st.sampled_from(["cut", "gone", "empty", "scribbled", "replaced byte"]))
def test_a_file_that_is_cut_gone_or_scribbled_over_is_found_and_put_aside(
    edited: Path, tmp_path: Path, seed: int, how: str
) -> None:
    rng = random.Random(seed)
    read = [file for file in files_of(edited) if is_read(file) and file.name != INDEX_FILE]
    # Nothing tells of a file of the history that is gone, and an undo refuses to go back further.
    file = rng.choice([file for file in read if how != "gone" or file.suffix != ".jsonl"])
    path = copy_of(edited, tmp_path / "set")
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
    if file.parts[0] == "episodes" and how != "gone":
        kept = [found.read_bytes() for found in (path / "quarantine").rglob(file.name)]
        assert damaged[how] in kept, "what was there is kept as it was"


@pytest.mark.parametrize("length", [0, 5])
def test_a_history_that_is_cut_within_its_first_line_is_found(edited: Path, tmp_path: Path, length: int) -> None:
    file = next(file for file in files_of(edited) if file.parts[0] == "history" and file.suffix == ".jsonl")
    path = copy_of(edited, tmp_path / "set")
    (path / file).write_bytes((path / file).read_bytes()[:length])
    require_found_and_mended(path, file, Dataset.open(edited), f"{file} cut at {length}")


def test_what_nothing_reads_may_change(edited: Path, tmp_path: Path) -> None:
    path = copy_of(edited, tmp_path / "set")
    strangers = [file for file in files_of(path) if not is_read(file)]
    assert len(strangers) == 4
    for file in strangers:
        (path / file).write_bytes(b"anything")
    assert not check(path).findings


def is_read(file: Path) -> bool:
    return file.parts[0] != "view" and file.name not in (*LOCK_FILES, "report.html")
