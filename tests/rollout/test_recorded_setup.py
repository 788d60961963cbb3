"""The setup of a dataset: it must not decide which code is imported."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature

import rcs
from rcs.errors import InvalidSetup
from rcs.rollout.recorded_setup import RECORDED, physics_of, setup_of
from rcs.rollout.replay import replay

JOINTS = Feature(key="observation/joints", shape=(7,), dtype="float64")
MODULE = "rcs_hostile_module_for_a_test"


def dataset_of(path: Path, setup: dict[str, object]) -> Dataset:
    info = DatasetInfo(frequency=30.0, features=(JOINTS,), setup=setup, instruction="", sim_state_size=3)
    DatasetWriter.open(path, info).close()
    return Dataset.open(path)


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module on the path that must not be imported; its task is that of the dataset `data` beside it."""
    (tmp_path / f"{MODULE}.py").write_text("from rcs.tasks.free import Free as Task\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    dataset_of(tmp_path / "data", rcs.Setup(task=f"{MODULE}:Task").to_json())
    return tmp_path


def test_a_module_that_only_the_dataset_names_is_refused_and_not_imported(hostile: Path) -> None:
    dataset = Dataset.open(hostile / "data")
    for read in (setup_of, physics_of):
        with pytest.raises(InvalidSetup, match=f"names a class of the module '{MODULE}'.*--trust {MODULE}"):
            read(dataset)
    with pytest.raises(InvalidSetup, match="not imported"):
        list(replay(dataset.path))
    assert MODULE not in sys.modules


def test_a_trusted_or_imported_module_is_accepted(hostile: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = Dataset.open(hostile / "data")
    assert setup_of(dataset, trust=(MODULE,)).task == f"{MODULE}:Task"
    assert list(replay(dataset.path, trust=(MODULE,))) == []
    assert MODULE in sys.modules
    assert setup_of(dataset).task == f"{MODULE}:Task"
    monkeypatch.delitem(sys.modules, MODULE)


def test_a_task_that_the_user_names_replaces_that_of_the_dataset(hostile: Path) -> None:
    dataset = Dataset.open(hostile / "data")
    assert setup_of(dataset, task="Free").task == "Free"
    assert setup_of(dataset, task=f"{MODULE}:Task").task == f"{MODULE}:Task"


def test_references_are_found_in_any_field_and_in_the_setup_of_the_states(hostile: Path) -> None:
    plain = rcs.Setup()
    options = replace(plain, task_options={"nested": [{"helper": f"{MODULE}.sub:make"}]}).to_json()
    with pytest.raises(InvalidSetup, match="not imported"):
        setup_of(dataset_of(hostile / "options", options))
    drawn = {**plain.to_json(), RECORDED: rcs.Setup(tactile=f"{MODULE}:Gel").to_json()}
    dataset = dataset_of(hostile / "drawn", drawn)
    assert setup_of(dataset) == plain
    with pytest.raises(InvalidSetup, match="not imported"):
        physics_of(dataset)
