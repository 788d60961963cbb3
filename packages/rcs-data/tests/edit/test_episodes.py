from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, check, edit
from rcs_data.errors import InvalidSetup

RGB, INTRINSICS = "observation/frames/wrist/rgb", "observation/frames/wrist/intrinsics"


def test_delete_and_keep_are_complements(dataset: Path, ids: list[str]) -> None:
    edit.delete(dataset, ids[:2])
    rest = Dataset.open(dataset).digest()
    edit.undo(dataset)
    edit.keep(dataset, ids[2:])
    assert Dataset.open(dataset).digest() == rest
    assert check(dataset).is_ok


def test_all_episodes_can_be_deleted(dataset: Path, ids: list[str]) -> None:
    edit.delete(dataset, ids)
    assert len(Dataset.open(dataset)) == 0
    edit.undo(dataset)
    assert len(Dataset.open(dataset)) == 4


@pytest.mark.parametrize(("first", "last"), [(0, -1), (2, -1), (5, 9), (12, 12), (0, -3)])
def test_a_trimmed_episode_has_what_it_showed_in_these_rows(dataset: Path, first: int, last: int) -> None:
    before = Dataset.open(dataset)["000000"]
    rows = slice(first, None if last == -1 else last + 1)
    columns = {feature.key: before.column(feature.key)[rows] for feature in before.info.features}
    states = before.sim_state()[rows]
    edit.trim(dataset, "000000", first=first, last=last)
    after = Dataset.open(dataset)["000000"]
    assert check(dataset).is_ok, str(check(dataset))
    for key, column in columns.items():
        is_unknown = after.info.feature(key).is_unknown_at_reset or key == "time/period"
        start = 1 if is_unknown else 0
        np.testing.assert_array_equal(after.column(key)[start:], column[start:], err_msg=key)
        if is_unknown and column.dtype.kind == "f":
            assert np.isnan(after.column(key)[0]).all()
    np.testing.assert_array_equal(after.sim_state(), states)
    assert (after.success, after.seed) == (before.success, before.seed)


def test_trimming_nothing_changes_no_bit(dataset: Path) -> None:
    before = Dataset.open(dataset)["000003"]
    digest = before.content_hash
    edit.trim(dataset, "000003")
    after = Dataset.open(dataset)["000003"]
    assert after.content_hash == before.content_hash
    assert after.content_hash == digest
    assert after.about["sha256"] == before.about["sha256"]


@pytest.mark.parametrize(("first", "last"), [(5, 4), (0, 13), (-1, 3), (13, -1)])
def test_rows_that_are_not_there_are_refused(dataset: Path, first: int, last: int) -> None:
    digest = Dataset.open(dataset).digest()
    with pytest.raises(InvalidSetup, match="between 0 and 12"):
        edit.trim(dataset, "000000", first=first, last=last)
    assert Dataset.open(dataset).digest() == digest


def test_relabelling_some_changes_those_and_relabelling_all_what_is_to_come(dataset: Path) -> None:
    edit.relabel(dataset, "schieb den Würfel 🟩", episodes=["000001"])
    opened = Dataset.open(dataset)
    assert [e.instruction for e in opened.episodes] == ["pick", "schieb den Würfel 🟩", "pick", "pick"]
    assert opened.info.instruction == "pick"
    edit.relabel(dataset, "push")
    opened = Dataset.open(dataset)
    assert {e.instruction for e in opened.episodes} == {opened.info.instruction} == {"push"}
    assert check(dataset).is_ok


@pytest.mark.parametrize("instruction", [float("nan"), 5, None, ["a"], "pick \udcff"])
def test_an_instruction_that_is_no_text_is_refused(dataset: Path, ids: list[str], instruction: Any) -> None:
    for chosen in (None, ids[:1]):
        with pytest.raises(InvalidSetup):
            edit.relabel(dataset, instruction, episodes=chosen)
    assert Dataset.open(dataset).history == ()


def test_numbers_of_numpy_are_numbers(dataset: Path) -> None:
    edit.trim(dataset, "000000", first=np.int64(1))  # pyright: ignore[reportArgumentType]
    edit.resample(dataset, np.float32(15))  # pyright: ignore[reportArgumentType]
    assert Dataset.open(dataset).info.frequency == 15.0
    assert DatasetInfo(frequency=np.int64(10), features=Dataset.open(dataset).info.features, setup={}, instruction="")


@pytest.mark.parametrize("first", [1.0, "1", None, True])
def test_what_is_no_whole_number_is_no_row(dataset: Path, first: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"first is .*; valid is a whole number\."):
        edit.trim(dataset, "000000", first=first)
