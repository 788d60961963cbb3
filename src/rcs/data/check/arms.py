"""Finds the arm of each column of joints among those installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from rcs.data.info import DatasetInfo
from rcs.errors import UnknownName

if TYPE_CHECKING:
    from rcs.robots.description import ArmDescription


class _Stand(Protocol):
    """One robot of a lab."""

    name: str
    arm: str


class _Lab(Protocol):
    """The part of a lab that is used here: its robots."""

    stands: Sequence[_Stand]


def find_arms(info: DatasetInfo) -> tuple[dict[str, ArmDescription], tuple[str, ...]]:
    """Return the arm of each column of joints, and notes on unknown ones.

    Args:
        info: What the dataset's episodes share; its setup names the robot.
    """
    columns = [f for f in info.features if f.key.startswith("observation/") and f.key.rsplit("/", 1)[-1] == "joints"]
    if not columns:
        return {}, ()
    robot: Any = info.setup.get("robot")
    if not isinstance(robot, str):
        return {}, ("Joints are not compared with limits: the setup names no robot.",)
    try:
        by_name = _arms_of(robot)
    except (UnknownName, ImportError) as err:
        return {}, (f"Joints are not compared with limits: {err}",)
    arms: dict[str, ArmDescription] = {}
    notes: list[str] = []
    for feature in columns:
        stand = feature.key.removeprefix("observation/").removesuffix("joints").rstrip("/")
        arm = by_name.get(stand)
        if arm is None or feature.shape != (arm.dof,):
            known = f"of {arm.dof} joints" if arm is not None else "of no such name"
            notes.append(
                f"{feature.key!r} {feature.shape} is not compared with limits: robot {robot!r} has an arm {known}."
            )
        else:
            arms[feature.key] = arm
    return arms, tuple(notes)


def _arms_of(robot: str) -> dict[str, ArmDescription]:
    """Return the arms of a robot by their names in keys; a single arm has the empty name."""
    from rcs.devices import lookup  # imports the core, which nothing else in a dataset needs

    if robot in lookup.names("arm"):
        return {"": lookup.find("arm", robot)}
    lab: _Lab = lookup.find("lab", robot)
    is_alone = len(lab.stands) == 1
    return {"" if is_alone else stand.name: lookup.find("arm", stand.arm) for stand in lab.stands}
