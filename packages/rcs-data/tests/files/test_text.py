"""Half of a surrogate pair is refused where it comes in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, strategies
from rcs_data import Dataset, DatasetWriter, Feature, check, edit, recover
from rcs_data.errors import InvalidSetup
from rcs_data.files.text import is_storable, mended_text

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

HALF = "pick \udcff"


@pytest.mark.parametrize("name", ["instruction", "setup", "versions", "origin"])
def test_what_a_dataset_shares_has_no_half_of_a_pair(name: str, make_info: MakeInfo) -> None:
    value: Any = HALF if name == "instruction" else {"note": HALF}
    with pytest.raises(InvalidSetup, match="half a surrogate pair"):
        make_info(**{name: value})


@pytest.mark.parametrize("values", [{"key": f"observation/{HALF}"}, {"unit": HALF}])
def test_a_feature_has_no_half_of_a_pair(values: dict[str, str]) -> None:
    with pytest.raises(InvalidSetup, match="half a surrogate pair"):
        Feature(**{"key": "reward", "shape": (), "dtype": "float64", **values})


def test_an_episode_is_refused_and_leaves_nothing(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        with pytest.raises(InvalidSetup, match="character 5 is half a surrogate pair"):
            writer.episode("a", seed=0, instruction=HALF)
        with pytest.raises(InvalidSetup, match="cannot name an episode"):
            writer.episode(HALF, seed=0)
        record(writer, "a")
    assert [episode.id for episode in Dataset.open(tmp_path)] == ["a"]
    assert check(tmp_path).is_ok


def test_what_is_said_in_the_end_is_refused_and_the_episode_stays_open(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in make_rows(3):
            episode.add(row, np.zeros(5))
        for outcome, words in (({"note": HALF}, None), ({HALF: 1}, None), ({}, HALF)):
            with pytest.raises(InvalidSetup, match="half a surrogate pair"):
                episode.finish(True, outcome, instruction=words)
            assert episode.state == "open"
        assert episode.finish(True).success is True


def test_an_abort_keeps_its_reason_as_far_as_it_is_text(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        episode.add(make_rows(1)[0], np.zeros(5))
        episode.abort(f"cannot open {HALF}")
    recover(tmp_path)
    assert Dataset.open(tmp_path)["a"].outcome["aborted"] == "cannot open pick \ufffd"


@pytest.mark.parametrize("ids", [None, ["000000"]])
def test_relabelling_refuses_it_and_changes_nothing(dataset: Path, ids: list[str] | None) -> None:
    with pytest.raises(InvalidSetup, match="half a surrogate pair"):
        edit.relabel(dataset, HALF, episodes=ids)
    assert Dataset.open(dataset).history == ()
    edit.relabel(dataset, "pick", episodes=ids)


@given(strategies.text(strategies.characters()))
def test_mended_text_can_be_stored_and_text_that_can_be_stored_stays(text: str) -> None:
    assert is_storable(mended_text(text))
    if is_storable(text):
        assert mended_text(text) == text
        assert json.loads(json.dumps(text)) == text
