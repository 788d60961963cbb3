"""The damping with which an arm that gives way as springs do comes back without swinging."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.kinematics.chain import GRIPPER_PREFIX, EndEffector, attach_end_effector, compiled, load
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription

RANK = 1e-4
"""Part of the largest mobility of a TCP below which it cannot move that way: arms of five joints."""


def damped(compliance: Compliance, arm: ArmDescription, effector: EndEffector | None) -> Compliance:
    """Return a compliance with a number for each joint of an arm or the six of its TCP, and with its damping.

    Where none is given, it is the critical one of each spring with the inertia that it feels at home while the other
    ones hold.

    Args:
        compliance: What is given.
        arm: The arm.
        effector: The gripper or hand at its flange.

    Raises:
        InvalidSetup: The arm has another number of joints.
    """
    given = compliance.of(arm)
    if given.damping is not None:
        return given
    inertia, jacobian = _at_home(arm, effector)
    felt = np.diag(inertia)
    if given.is_of_tcp:
        mobility = jacobian @ np.linalg.solve(inertia, jacobian.T)
        # Where an arm cannot move in all directions, what the others hold is not defined.
        felt = np.maximum(np.diag(np.linalg.pinv(mobility, rcond=RANK, hermitian=True)), 1.0 / np.diag(mobility))
    damping = 2.0 * np.sqrt(np.array(given.gains[0]) * felt)
    return replace(given, damping=tuple(damping.tolist()))


def _at_home(arm: ArmDescription, effector: EndEffector | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the inertia of an arm at home, (dof, dof), and the Jacobian of its TCP, (6, dof)."""
    spec, tcp = load(arm), arm.flange_site
    if effector is not None:
        attach_end_effector(spec, arm, effector)
        tcp = GRIPPER_PREFIX + effector.tcp_site
    model = compiled(spec, [arm] if effector is None else [arm, effector])
    data = mujoco.MjData(model)
    for name, position in zip(arm.joints, arm.home, strict=True):
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    unit, inertia = np.eye(model.nv)[dofs], np.zeros((arm.dof, model.nv))
    for row, one in zip(inertia, unit, strict=True):
        mujoco.mj_mulM(model, data, row, one)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(tcp).id)
    base = data.body(arm.base_body).xmat.reshape(3, 3).T
    jacobian = np.concatenate([base @ jacobian[:3], base @ jacobian[3:]])
    return inertia[:, dofs], jacobian[:, dofs]
