from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.errors import InvalidSetup
from rcs.rl import Flat, FlatLayout

BOX = spaces.Box(0, 1, (1,), np.float32)


def test_a_layout_prints_every_number_with_its_unit_and_source() -> None:
    flat = Flat(rcs.make(observe=("privileged",)))
    text = str(flat.layout)
    assert "(value - [0 … 0.5]) / 0.25 m; half the diagonal of the task's area" in text
    assert "rad/s; the arm's velocity limits" in text
    assert repr(flat) == f"Flat({flat.layout.state_size} numbers -> 8 numbers)"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda values: values.update(version=99), "version 99; this program reads version 1"),
        (lambda values: values.pop("state"), "The layout is damaged: KeyError"),
        (lambda values: values["state"][1].update(colour="red"), "The layout is damaged: TypeError"),
        (lambda values: values["state"][1]["scale"].append(1.0), "'gripper' does not fit its place"),
        (lambda values: values["state"][1].update(kind="guess"), "'gripper' does not fit its place"),
        (lambda values: values["state"].pop(0), "'gripper' does not fit its place"),
        (lambda values: values["state"][1].update(scale=[0.0]), "'gripper' does not fit its place"),
        (lambda values: values.update(images=[{"path": ["a"], "name": "a", "shape": [3, 4]}]), "image 'a'"),
    ],
)
def test_a_damaged_layout_is_refused(damage: Any, message: str) -> None:
    flat = Flat.from_spaces(spaces.Dict(a=BOX), spaces.Dict(joints=BOX, gripper=BOX))
    values = flat.layout.to_json()
    FlatLayout.from_json(values)
    damage(values)
    with pytest.raises(InvalidSetup, match=message):
        FlatLayout.from_json(values)
    with pytest.raises(InvalidSetup, match="The layout has version 'list'"):
        FlatLayout.from_json([])
