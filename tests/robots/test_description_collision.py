"""Limits of the forces on an arm."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from rcs.errors import InvalidSetup
from rcs.robots import FR3, SO101, UR5E, XARM7, CollisionLimits


@pytest.mark.parametrize("arm", [FR3, SO101, UR5E, XARM7], ids=lambda arm: arm.name)
def test_every_arm_feels_a_collision_before_its_drives_give_in(arm: Any) -> None:
    limits = arm.collision
    within = [torque < effort for torque, effort in zip(limits.joint_torque, arm.effort_limit, strict=True)]
    # A limit of the force stands in for those of joints that the vendor does not publish.
    assert sum(within) >= 3 or math.isfinite(limits.force)


@pytest.mark.parametrize(
    "change",
    [
        {"joint_torque": (0.0,) * 7},
        {"force": -1.0},
        {"moment": math.nan},
        {"duration": -1.0},
        {"time_constant": math.inf},
    ],
    ids=lambda change: next(iter(change)),
)
def test_limits_that_make_no_sense_are_refused(change: Any) -> None:
    form: dict[str, Any] = {"joint_torque": (10.0,) * 7, **change}
    with pytest.raises(InvalidSetup, match="valid"):
        CollisionLimits(**form)


def test_every_joint_has_its_limit() -> None:
    with pytest.raises(InvalidSetup, match="2 joint torques for 7 joints"):
        replace(FR3, collision=CollisionLimits(joint_torque=(1.0, 1.0)))
