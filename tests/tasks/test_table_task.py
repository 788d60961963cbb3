"""A task that is given other robots than it needs says which of the installed ones would do."""

from __future__ import annotations

import pytest

import rcs
from rcs.errors import InvalidSetup
from rcs.setups.ids import ids


@pytest.mark.parametrize(
    ("task", "robot", "words"),
    [
        ("PickCuboid", "xarm7", ["'xarm7' has Tilburg Hand", "end_effector=, --end-effector", "robotiq_2f85"]),
        ("Place", "xarm7", ["Place needs one robot with a gripper", "--end-effector", "robotiq_2f85"]),
        ("LiftBar", "fr3", ["needs 2 robots, each with a gripper; this setup has 1", "(robot=, --robot): dual_fr3."]),
        ("PickCuboid", "dual_fr3", ["needs one robot with a gripper; this setup has 2", "--robot): fr3, so101, ur5e."]),
        ("PickToy", "dual_fr3", ["a gripper or a hand", "--robot): fr3, so101, ur5e, xarm7."]),
    ],
)
def test_what_would_fit_is_named(task: str, robot: str, words: list[str]) -> None:
    with pytest.raises(InvalidSetup) as told:
        rcs.make(task, robot=robot)
    for word in words:
        assert word in str(told.value)


def test_a_bare_flange_is_told_of_end_effectors_that_its_arm_can_carry() -> None:
    with pytest.raises(InvalidSetup, match=r"'so101' has none. .*--end-effector\): so101_gripper\.$"):
        rcs.make("Push", robot="so101", end_effector="none")


def test_what_is_named_fits() -> None:
    with rcs.make("PickCuboid", robot="xarm7", end_effector="robotiq_2f85") as env:
        env.reset(seed=0)
    assert ("LiftBar", "dual_fr3") in ids().values()
