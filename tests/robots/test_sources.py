"""Every figure of a robot comes from somewhere: descriptions and model files say from where."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

from rcs.devices import lookup
from rcs.robots import DIGIT
from rcs.robots.description import ArmDescription, Description

ARMS = [lookup.find("arm", name) for name in ("fr3", "so101", "ur5e", "xarm7")]
HANDS = [lookup.find("gripper", name) for name in ("franka_hand", "robotiq_2f85", "so101_gripper")]
HANDS += [lookup.find("hand", "tilburg_hand"), DIGIT]
CONTACT = ("friction", "solref", "solimp")


def says(description: Description, *words: str) -> bool:
    """Return whether a source, or the comment beside a figure that is our own choice, names one of the words."""
    path = Path(import_module(description.module).__file__ or "")
    comments = [line for line in path.read_text().splitlines() if line.lstrip().startswith("#")]
    return any(word in text.lower() for text in (*description.sources, *comments) for word in words)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_an_arm_names_the_source_of_each_kind_of_figure(arm: ArmDescription) -> None:
    assert all(re.match(r"[^:]+: \w", source) for source in arm.sources), "source: what comes from it"
    assert says(arm, "kinematics")
    for kind in (
        ("velocity", "speed"),
        ("acceleration", "not published"),
        ("jerk", "our"),
        ("effort", "torque"),
        ("reach",),
    ):
        assert says(arm, *kind), kind
    assert says(arm, "inertia", "inertias")
    assert says(arm, "gains", "servo")
    assert arm.payload is None or says(arm, "payload")


@pytest.mark.parametrize("hand", HANDS, ids=lambda hand: hand.name)
def test_what_grasps_names_the_source_of_friction_and_stiffness(hand: Description) -> None:
    assert all(re.match(r"[^:]+: \w", source) for source in hand.sources)
    assert any("friction and stiffness" in source for source in hand.sources)


@pytest.mark.parametrize("description", [*ARMS, *HANDS], ids=lambda description: description.name)
def test_a_model_file_says_where_its_figures_come_from_and_comments_what_touches(description: Description) -> None:
    text = description.mjcf.read_text()
    head = text[: text.index("<mujoco")]
    mentioned = [source for source in description.sources if any(word in head for word in _names(source))]
    assert mentioned, "the head of the file names a source"
    # Whatever is said of a contact in a file has a comment right above.
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if "<geom" in line and any(f"{field}=" in line for field in CONTACT):
            above = "\n".join(lines[max(0, number - 9) : number])
            assert "<!--" in above, line


def _names(source: str) -> set[str]:
    """Return the words by which a source is recognised."""
    return set(re.findall(r"[\w.-]{5,}", source.partition(":")[0])) - {"sheet", "manual", "product", "Clause"}
