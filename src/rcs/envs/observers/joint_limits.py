"""Tells a dataset what the joints of its robots can do, so that it is checked wherever it lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rcs_data import Feature, JointBounds

from rcs.devices import lookup
from rcs.robots.description import ArmDescription


def with_limits(features: Sequence[Feature], robot: str | Mapping[str, str] | None) -> list[Feature]:
    """Return features of observations, with the limits of each arm's joints at those that are joint positions.

    Args:
        features: Features of observations.
        robot: The robot of the setup: an arm, a lab, or arms by name; None where there is no setup.
    """
    arms = {} if robot is None else _arms_of(robot)
    limits = {f"observation/{name}/joints".replace("//", "/"): limits_of(arm) for name, arm in arms.items()}
    return [replace(feature, limits=limits.get(feature.key)) for feature in features]


def limits_of(arm: ArmDescription) -> JointBounds:
    """Return the limits of an arm's joints as a dataset has them."""
    return JointBounds(
        arm=arm.label, names=arm.joints, lower=arm.joint_lower, upper=arm.joint_upper, velocity=arm.velocity_limit
    )


def _arms_of(robot: str | Mapping[str, str]) -> dict[str, ArmDescription]:
    """Return the arms of a robot by their names in keys; a single arm has the empty name."""
    if isinstance(robot, str):
        if robot in lookup.names("arm"):
            return {"": lookup.find("arm", robot)}
        found = lookup.find("lab", robot)
        robot = {stand.name: stand.arm for stand in getattr(found, "stands", ())}
        if not robot:
            return {"": found}
    return {"" if len(robot) == 1 else name: lookup.find("arm", arm) for name, arm in robot.items()}
