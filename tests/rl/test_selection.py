from __future__ import annotations

import json
from typing import Any

import pytest

from rcs.errors import InvalidSetup
from rcs.rl import Selection


@pytest.mark.parametrize(
    "selection",
    [Selection(), Selection(keys=("joints",), actions=("joints[0:3]",), features=("near",), cameras=("wrist",))],
)
def test_a_selection_survives_json(selection: Selection) -> None:
    assert Selection.from_json(json.loads(json.dumps(selection.to_json()))) == selection


def test_sequences_become_tuples() -> None:
    given: Any = ["joints", "gripper"]
    assert Selection(keys=given) == Selection(keys=("joints", "gripper"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"keys": "joints"}, r"keys is the text 'joints'; give a sequence, such as \['joints'\]"),
        ({"actions": [1]}, r"actions is \[1\]; valid is a sequence of names"),
        ({"features": None}, "features is None; valid is a sequence of names"),
        ({"features": ["goal"]}, r"features has \['goal'\]; valid: 'offset', 'near'"),
        ({"key": []}, "Did you mean 'keys'"),
    ],
)
def test_a_wrong_selection_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetup, match=message):
        Selection.from_json(values)
