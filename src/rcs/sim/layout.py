"""Indices of a robot's joints, controls and bodies in a model, looked up once by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.sim.scene import RobotPlacement

Index = slice | NDArray[np.intp]
"""Selects elements of the last axis; a slice if they are neighbours, which costs a third."""


@dataclass(frozen=True, kw_only=True)
class RobotLayout:
    """Indices of one robot in a model."""

    joint_ids: list[int]
    actuator_ids: list[int]
    qpos: Index
    qvel: Index
    motion: int
    """First number of the arm's motion in the user data."""
    base_body: int
    tcp_site: int
    finger_joint_ids: list[int]
    finger_qpos: Index
    finger_qvel: Index
    finger_actuator: int
    """Control index of the gripper, -1 without one."""
    hand_joint_ids: list[int]
    hand_actuator_ids: list[int]
    hand_qpos: Index
    hand_ctrl: Index

    @staticmethod
    def of(robot: RobotPlacement, model: mujoco.MjModel) -> RobotLayout:
        """Look a robot up in a model.

        Raises:
            InvalidSetup: The robot is not in the model.
        """
        gripper, hand, prefix = robot.gripper, robot.hand, robot.gripper_prefix

        def ids(find: Any, prefix: str, names: Iterable[str]) -> list[int]:
            return [find(prefix + name).id for name in names]

        try:
            joints = ids(model.joint, robot.prefix, robot.arm.joints)
            actuators = ids(model.actuator, robot.prefix, robot.arm.actuators)
            fingers = ids(model.joint, prefix, gripper.joints if gripper is not None else ())
            drives = ids(model.actuator, prefix, [gripper.actuator] if gripper is not None else ())
            hand_joints = ids(model.joint, prefix, hand.joints if hand is not None else ())
            hand_actuators = ids(model.actuator, prefix, hand.actuators if hand is not None else ())
            base = model.body(robot.base_body).id
            tcp = model.site(robot.tcp_site).id
            motion = int(model.numeric(robot.motion).data[0])
        except KeyError as err:
            raise InvalidSetup(f"Robot {robot.name!r} is not in this model: {err}") from err
        return RobotLayout(
            joint_ids=joints,
            actuator_ids=actuators,
            qpos=_index(model.jnt_qposadr[joints]),
            qvel=_index(model.jnt_dofadr[joints]),
            motion=motion,
            base_body=base,
            tcp_site=tcp,
            finger_joint_ids=fingers,
            finger_qpos=_index(model.jnt_qposadr[fingers]),
            finger_qvel=_index(model.jnt_dofadr[fingers]),
            finger_actuator=drives[0] if drives else -1,
            hand_joint_ids=hand_joints,
            hand_actuator_ids=hand_actuators,
            hand_qpos=_index(model.jnt_qposadr[hand_joints]),
            hand_ctrl=_index(np.array(hand_actuators)),
        )


def _index(values: NDArray[np.integer]) -> Index:
    ids = np.asarray(values, np.intp)
    if len(ids) and (np.diff(ids) == 1).all():
        return slice(int(ids[0]), int(ids[-1]) + 1)
    return ids
