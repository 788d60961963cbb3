"""Indices of a robot's joints, controls and bodies in a model, looked up once by name."""

from __future__ import annotations

from dataclasses import dataclass

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
        try:
            joints = [model.joint(robot.prefix + name).id for name in robot.arm.joints]
            actuators = [model.actuator(robot.prefix + name).id for name in robot.arm.actuators]
            fingers: list[int] = []
            finger_actuator = -1
            if robot.gripper is not None:
                fingers = [model.joint(robot.gripper_prefix + name).id for name in robot.gripper.joints]
                finger_actuator = model.actuator(robot.gripper_prefix + robot.gripper.actuator).id
            hand_joints: list[int] = []
            hand_actuators: list[int] = []
            if robot.hand is not None:
                hand_joints = [model.joint(robot.gripper_prefix + name).id for name in robot.hand.joints]
                hand_actuators = [model.actuator(robot.gripper_prefix + name).id for name in robot.hand.actuators]
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
            finger_actuator=finger_actuator,
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
