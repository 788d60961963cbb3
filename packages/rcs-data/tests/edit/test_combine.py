from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rcs_data import Dataset, check, edit
from rcs_data.errors import DatasetError, InvalidSetup

if TYPE_CHECKING:
    from conftest import MakeDataset


def test_merge_then_split_gives_back_both_by_hash(tmp_path: Path, make_dataset: MakeDataset) -> None:
    a = make_dataset(tmp_path / "real", [5, 3, 7], seed=1)
    b = make_dataset(
        tmp_path / "sim", [4, 6], seed=2, setup={"robot": "ur5e", "relative": "last_step"}, instruction="push"
    )
    merged = edit.merge([a, b], tmp_path / "both")
    assert len(merged) == 5
    assert check(merged.path).is_ok
    parts = edit.split(merged.path, tmp_path / "parts")
    for path in (a, b):
        source, part = Dataset.open(path), parts[path.name]
        assert part.digest() == source.digest()
        assert part.info == source.info
        for before, after in zip(source.episodes, part.episodes, strict=True):
            assert {**before.about, "source": None} == {**after.about, "source": None}
        assert check(part.path).is_ok


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(shares=st.lists(st.integers(0, 5), min_size=1, max_size=4).filter(any), seed=st.integers(0, 99))
def test_split_then_merge_is_the_identity_by_hash(
    dataset: Path, shares: list[int], seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    out = tmp_path_factory.mktemp("split")
    parts = {f"part{i}": share / sum(shares) for i, share in enumerate(shares)}
    made = edit.split(dataset, out, parts=parts, seed=seed)
    merged = edit.merge([part.path for part in made.values()], out / "merged")
    assert merged.digest() == Dataset.open(dataset).digest()
    assert merged.info == Dataset.open(dataset).info


def test_the_draw_depends_on_the_seed_alone(dataset: Path, tmp_path: Path) -> None:
    def train(out: str, seed: int) -> list[str]:
        made = edit.split(dataset, tmp_path / out, parts={"train": 0.5, "val": 0.5}, seed=seed)
        return [episode.id for episode in made["train"].episodes]

    assert train("a", 1) == train("b", 1)
    assert len({tuple(train(f"seed{seed}", seed)) for seed in range(8)}) > 1


def test_two_sources_with_the_same_ids_and_name_are_told_apart(tmp_path: Path, make_dataset: MakeDataset) -> None:
    a = make_dataset(tmp_path / "1" / "data", [3], seed=1)
    b = make_dataset(tmp_path / "2" / "data", [4], seed=2)
    merged = edit.merge([a, b], tmp_path / "both")
    assert [episode.id for episode in merged.episodes] == ["data-2.000000", "data.000000"]
    sources = [episode.source for episode in merged.episodes]
    assert [source and source["episode"] for source in sources] == ["000000", "000000"]
    assert sources[1] is not None
    assert sources[1]["digest"] == Dataset.open(a).digest()
    again = edit.merge([merged.path], tmp_path / "again")
    origin = again.episodes[0].source
    assert origin is not None
    assert origin["source"] == sources[0]  # provenance goes back to the first


def test_what_does_not_fit_is_refused_with_what_differs(tmp_path: Path, make_dataset: MakeDataset) -> None:
    a = make_dataset(tmp_path / "a", [3])
    b = make_dataset(tmp_path / "b", [3], start=5)
    edit.resize(b, (12, 8))
    with pytest.raises(DatasetError, match=r"(?s)a and b do not fit.*wrist/depth: a has .*16, 24.* b has .*8, 12"):
        edit.merge([a, b], tmp_path / "both")
    assert not (tmp_path / "both").exists()
    assert not list(tmp_path.glob(".both*"))


def test_a_folder_that_is_not_empty_is_left_alone(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious").write_text("x")
    with pytest.raises(DatasetError, match="exists already"):
        edit.merge([dataset], tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["precious"]


def test_what_makes_no_sense_is_refused(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="sum up to 1"):
        edit.split(dataset, tmp_path, parts={"a": 0.5, "b": 0.6})
    with pytest.raises(InvalidSetup, match="not merged"):
        edit.split(dataset, tmp_path)
    for seed in (-1, 1.5):
        with pytest.raises(InvalidSetup, match=f"The seed is {seed}; valid is a whole number from 0"):
            edit.split(dataset, tmp_path, parts={"a": 1.0}, seed=seed)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidSetup, match="at least one"):
        edit.merge([], tmp_path / "out")


def test_a_split_is_whole_or_nothing(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / "val").mkdir(parents=True)
    (tmp_path / "out" / "val" / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="exists already"):
        edit.split(dataset, tmp_path / "out", parts={"train": 0.5, "val": 0.5})
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["val"]


def test_a_merge_syncs_once_at_its_end(
    tmp_path: Path, make_dataset: MakeDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill throws away what it has made until then."""
    counts: list[int] = []
    for episodes in (2, 6):
        source, calls = make_dataset(tmp_path / f"of-{episodes}", [3] * episodes), list[int]()
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", calls.append)
            edit.merge([source], tmp_path / f"merged-{episodes}")
        counts.append(len(calls))
    assert counts[0] == counts[1] <= 3
