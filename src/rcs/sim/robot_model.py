"""A robot's model in a scene: servos that give way to a push, a body that carries a load, and checks of its weight."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Springs
from rcs.errors import InvalidSetup
from rcs.kinematics.chain import damped, flange_frame
from rcs.robots.description import ArmDescription
from rcs.spatial import Pose, wxyz_to_xyzw

if TYPE_CHECKING:  # a scene changes and checks its robots
    from rcs.sim.scene import RobotPlacement

LOAD = "load"
"""Name of the body at a robot's flange that carries the compensation of a load (`SimRobot.set_load`)."""
LOAD_MASS = 1e-6
"""Its mass [kg], too small for anything else to notice."""
MAX_TCP_SAG = 0.002
"""Sag of the TCP at home above which to warn [m]: from 2.3 mm on, scripted grasps fail (measured)."""
MAX_JOINT_SAG = 0.005
"""The same for a joint [rad]: 2 mm at a lever of 0.4 m."""
BASE_TOLERANCE = 1e-6
"""Tolerance of a base's pose for rounding [m, rad]."""


def give_way(spec: mujoco.MjSpec, robot: RobotPlacement) -> None:
    """Make the servos in the model of an arm give way if the robot has a compliance.

    Controllers that lead an arm by torques measure them behind the gears and compensate friction, so joints have none.

    Args:
        spec: Model of the arm alone, changed in place.
        robot: The robot.

    Raises:
        InvalidSetup: The compliance is of another number of joints.
    """
    compliance = robot.compliance
    if compliance is None:
        return
    stiffness, damping = damped(compliance, robot.arm, robot.end_effector).gains
    for i, (joint_name, actuator_name) in enumerate(zip(robot.arm.joints, robot.arm.actuators, strict=True)):
        joint, servo = spec.joint(joint_name), spec.actuator(actuator_name)
        joint.frictionloss, joint.damping = 0.0, np.zeros_like(joint.damping)
        if compliance.is_of_tcp:
            servo.set_to_motor()
        else:
            servo.set_to_position(kp=stiffness[i], kv=damping[i])


def springs_of(robot: RobotPlacement, tcp_site: int, base_body: int) -> Springs | None:
    """Return the springs of a robot's motion; None for stiff servos.

    Args:
        robot: The robot.
        tcp_site: Id of its TCP.
        base_body: Id of its base.
    """
    if robot.compliance is None:
        return None
    if not robot.compliance.is_of_tcp:
        return Springs()
    return Springs(*damped(robot.compliance, robot.arm, robot.end_effector).gains, tcp_site, base_body)


def add_load(spec: mujoco.MjSpec, arm: ArmDescription) -> None:
    """Add the body of `SimRobot.set_load` to a flange: MuJoCo compensates gravity in proportion to a body's mass."""
    flange = flange_frame(spec, arm)
    flange.parent.add_body(
        name=LOAD,
        mass=LOAD_MASS,
        # Not in the origin: there MuJoCo takes the centre of mass for that of the frame, whatever is written later.
        ipos=[0.0, 0.0, 1e-3],
        inertia=[1e-12] * 3,
        explicitinertial=True,
        gravcomp=1.0,
    ).set_frame(flange)


def check_robot(robot: RobotPlacement, model: mujoco.MjModel) -> None:
    """Check that the base is where the robot was placed, and warn if its servos cannot carry its weight.

    Args:
        robot: The robot.
        model: The compiled scene.

    Raises:
        InvalidSetup: Its base body has a pose in its file.
    """
    _require_base(robot, _at_home(robot, model))
    joints, tcp = sag_of(robot, model)
    worst = int(np.abs(joints).argmax())
    if robot.compliance is None and not (abs(joints[worst]) <= MAX_JOINT_SAG and tcp <= MAX_TCP_SAG):
        warnings.warn(
            f"Robot {robot.name!r} sags: while holding its home pose, joint {robot.arm.joints[worst]!r} gives way by  "
            f"{abs(joints[worst]):.3g} rad and the TCP by {1e3 * tcp:.2g} mm, so that it misses what it "
            f'reaches for. Add gravcomp="1" to every body in {robot.arm.mjcf_file} if its controller compensates '
            "the weight, or raise the servos' gain (kp).",
            stacklevel=3,
        )


def sag_of(robot: RobotPlacement, model: mujoco.MjModel) -> tuple[NDArray[np.float64], float]:
    """Return how far a robot sags while its servos hold it at home: uncompensated weight over their stiffness.

    Returns:
        Sag of each joint, (dof,) [rad], infinite for one without a position servo; and of the TCP [m].
    """
    data = _at_home(robot, model)
    dofs = [int(model.joint(robot.prefix + name).dofadr[0]) for name in robot.arm.joints]
    servos = [model.actuator(robot.prefix + name).id for name in robot.arm.actuators]
    missing = (data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)[dofs]
    stiffness = -model.actuator_biasprm[servos, 1]
    if (stiffness <= 0.0).any():  # without a position servo nothing holds the joint
        return np.where(stiffness > 0.0, 0.0, np.inf), np.inf
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(robot.tcp_site).id)
    joints = missing / stiffness
    return joints, float(np.linalg.norm(jacobian[:, dofs] @ joints))


def _at_home(robot: RobotPlacement, model: mujoco.MjModel) -> mujoco.MjData:
    """Return data with the robot at rest at home and its targets there; forces are computed without contacts."""
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
