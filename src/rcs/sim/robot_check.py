"""Checks a robot in a compiled scene for what would otherwise only be seen in bad episodes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.spatial import Pose, wxyz_to_xyzw

if TYPE_CHECKING:  # a scene makes these checks
    from rcs.sim.scene import RobotPlacement

MAX_TCP_SAG = 0.002
"""A TCP that sags further than this at home is worth a warning [m]: from 2.3 mm on, scripted grasps fail (measured)."""
MAX_JOINT_SAG = 0.005
"""The same for a joint [rad]: 2 mm at a lever of 0.4 m."""
BASE_TOLERANCE = 1e-6
"""What rounding may move a base by [m, rad]."""


@dataclass(frozen=True, kw_only=True)
class Sag:
    """How far a robot sinks below its home pose while its servos are told to hold it there."""

    joints: NDArray[np.float64]
    """Of each joint, (dof,) [rad]; infinite for a joint without a position servo."""
    tcp: float
    """Of the TCP [m]."""

    @property
    def is_small(self) -> bool:
        """Whether neither a joint nor the TCP sinks noticeably."""
        return bool(np.abs(self.joints).max() <= MAX_JOINT_SAG) and self.tcp <= MAX_TCP_SAG


def check_robot(robot: RobotPlacement, model: mujoco.MjModel) -> None:
    """Check that the base is where the robot was put, and warn if its servos do not carry it.

    Args:
        robot: The robot.
        model: The scene that it stands in.

    Raises:
        InvalidSetup: Its base body has a pose of its own in its file.
    """
    data = _at_home(robot, model)
    _require_base(robot, data)
    sag = _sag(robot, model, data)
    if not sag.is_small:
        worst = int(np.abs(sag.joints).argmax())
        warnings.warn(
            f"Robot {robot.name!r} sags: told to hold its home pose, joint {robot.arm.joints[worst]!r} gives way by "
            f"{abs(sag.joints[worst]):.3g} rad and the TCP by {1e3 * sag.tcp:.2g} mm, so that it misses what it "
            f'reaches for. Add gravcomp="1" to every body in {robot.arm.mjcf_file} if its controller compensates '
            "the weight, or raise the servos' gain (kp).",
            stacklevel=3,
        )


def sag_of(robot: RobotPlacement, model: mujoco.MjModel) -> Sag:
    """Return how far a robot sags at home: the weight that is not compensated, over the servos' stiffness."""
    return _sag(robot, model, _at_home(robot, model))


def _at_home(robot: RobotPlacement, model: mujoco.MjModel) -> mujoco.MjData:
    """Return data with the robot at home, at rest and told to stay; forces are computed, contacts are not solved."""
    data = mujoco.MjData(model)
    for joint, actuator, q in zip(robot.arm.joints, robot.arm.actuators, robot.arm.home, strict=True):
        data.joint(robot.prefix + joint).qpos[0] = data.actuator(robot.prefix + actuator).ctrl[0] = q
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fwdActuation(model, data)
    return data


def _require_base(robot: RobotPlacement, data: mujoco.MjData) -> None:
    body = data.body(robot.base_body)
    off = robot.base_in_scene.pose.inverse() * Pose(body.xpos, wxyz_to_xyzw(body.xquat))
    distance, angle = np.linalg.norm(off.translation), np.linalg.norm(off.rotvec)
    if max(distance, angle) > BASE_TOLERANCE:
        raise InvalidSetup(
            f"Robot {robot.name!r}: in {robot.arm.mjcf_file}, the body {robot.arm.base_body!r} is moved by "
            f"{distance:.3g} m and turned by {np.degrees(angle):.3g} degrees. Its frame is the robot's base frame, so "
            "the file must give it no pose. Remove its pos and quat; or, if the arm is to stand turned in its base "
            "frame, put the body into a new outer one without a pose, and name that one as base_body."
        )


def _sag(robot: RobotPlacement, model: mujoco.MjModel, data: mujoco.MjData) -> Sag:
    dofs = [int(model.joint(robot.prefix + name).dofadr[0]) for name in robot.arm.joints]
    servos = [model.actuator(robot.prefix + name).id for name in robot.arm.actuators]
    missing = (data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)[dofs]
    stiffness = -model.actuator_biasprm[servos, 1]
    if (stiffness <= 0.0).any():  # not a position servo: nothing holds the joint
        return Sag(joints=np.where(stiffness > 0.0, 0.0, np.inf), tcp=np.inf)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(robot.tcp_site).id)
    joints = missing / stiffness
    return Sag(joints=joints, tcp=float(np.linalg.norm(jacobian[:, dofs] @ joints)))
