"""A dataset's description survives JSON, names what differs, and refuses what is too new."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import SCHEMA_VERSION, DatasetInfo, Feature
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.info import differences

if TYPE_CHECKING:
    from conftest import MakeInfo


def test_an_info_survives_json(make_info: MakeInfo) -> None:
    info = make_info(images=True, versions={"rcs": "0.1"}, setup={"robot": "fr3", "cameras": ["wrist"]})
    assert DatasetInfo.from_json(json.loads(json.dumps(info.to_json()))) == info


def test_an_info_does_not_differ_from_itself(make_info: MakeInfo) -> None:
    info = make_info(setup={"pose": (1.0, 2.0)})
    assert differences(DatasetInfo.from_json(json.loads(json.dumps(info.to_json()))), info) == []


def test_software_versions_do_not_make_a_difference(make_info: MakeInfo) -> None:
    assert differences(make_info(versions={"rcs": "0.1"}), make_info(versions={"rcs": "0.2"})) == []


def test_each_difference_is_one_line(make_info: MakeInfo) -> None:
    info = make_info(setup={"robot": "fr3", "task": {"name": "PickCuboid", "goal": 0.1}})
    features = (
        *(replace(f, dtype="float32") if f.key == "observation/joints" else f for f in info.features[1:]),
        Feature(key="executed/joints", shape=(3,), dtype="float64"),
    )
    other = replace(
        info, frequency=15.0, features=features, setup={"robot": "fr3", "task": {"name": "PickCuboid", "goal": 1}}
    )
    assert differences(info, other) == [
        "setup.task.goal: the dataset has 0.1, this setup has 1",
        "frequency: the dataset has 30.0, this setup has 15.0",
        "features.executed/joints: this setup has '(3,) float64 plain', which is not in the dataset",
        "features.observation/joints: the dataset has '(3,) float64 [rad] plain', which is not in this setup",
    ]


def test_another_order_of_the_features_is_a_difference(make_info: MakeInfo) -> None:
    info = make_info()
    assert "order" in differences(info, replace(info, features=info.features[::-1]))[0]


@pytest.mark.parametrize(
    "changes",
    [
        {"frequency": 0.0},
        {"frequency": math.nan},
        {"features": ()},
        {"features": (Feature(key="reward", shape=(), dtype="float64"),) * 2},
        {"frequency": np.complex128(10)},
        {"jpeg_quality": 0},
        {"jpeg_subsampling": "411"},
        {"sim_state_size": 0},
        {"setup": {"robot": object()}},
        {"setup": {"speed": math.inf}},
    ],
)
def test_an_info_that_makes_no_sense_is_refused(make_info: MakeInfo, changes: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup):
        make_info(**changes)


def test_numbers_of_numpy_become_pythons(make_info: MakeInfo) -> None:
    changes: dict[str, Any] = {"frequency": 10, "jpeg_quality": 90, "sim_state_size": 3}
    given = {name: np.int64(value) for name, value in changes.items()}
    assert json.dumps(make_info(**given).to_json()) == json.dumps(make_info(**changes).to_json())
    assert json.loads(json.dumps(make_info(frequency=np.float32(0.5)).to_json()))["frequency"] == 0.5


def test_a_newer_layout_is_refused_with_the_remedy(make_info: MakeInfo) -> None:
    values = make_info().to_json()
    with pytest.raises(DatasetError, match="Update this library"):
        DatasetInfo.from_json({**values, "schema_version": SCHEMA_VERSION + 1})
    with pytest.raises(DatasetError, match="has schema version 'one'"):
        DatasetInfo.from_json({**values, "schema_version": "one"})


def test_an_unknown_feature_is_answered_with_the_nearest_and_all_known_ones(make_info: MakeInfo) -> None:
    with pytest.raises(
        InvalidSetup, match=r"Did you mean 'observation/joints'.*observation/gripper, observation/joints"
    ):
        make_info().feature("observation/jonits")


def test_what_the_setup_says_comes_before_what_follows_from_it(make_info: MakeInfo) -> None:
    info = make_info(setup={"task": "Push", "robot": "fr3", "assets": "builtin"}, origin={"cameras": {"side": 1}})
    other = replace(
        info,
        frequency=2 * info.frequency,
        features=info.features[1:],
        setup={"task": "PickCuboid", "robot": "ur5e", "assets": "menagerie"},
        origin={"cameras": {"top": 1}},
    )
    names = [line.partition(":")[0] for line in differences(info, other)]
    assert names[:4] == ["setup.task", "setup.robot", "setup.assets", "frequency"]
    assert names[-1].startswith("origin.")
