"""Kinematics by Pinocchio, a second backend behind the same interface; `pip install 'robot-control-stack[pinocchio]'`.

The chain comes from the compiled model of MuJoCo, joint by joint. Pinocchio's own reader of MJCF knows no includes and
leaves out bodies without a word. Poses and Jacobians are Pinocchio's; the solver is the built-in one, slower here since
it calls Python. It is there for those who go on with Pinocchio's model (`model`, `frame`), and to check one against
the other.
"""

from __future__ import annotations

import threading
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import Kinematics
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.spatial import Pose, wxyz_to_xyzw

Vector = NDArray[np.float64]


class PinocchioKinematics(Kinematics):
    """Forward and inverse kinematics of one arm by Pinocchio."""

    def __init__(self, model: mujoco.MjModel, joints: list[int], tcp_site: int, base_body: int) -> None:
        """Take the chain out of a compiled model.

        Args:
            model: The model; it is not kept.
            joints: Ids of its hinges and slides, base to tip.
            tcp_site: Id of the site at the TCP.
            base_body: Id of the body whose frame poses are in.

        Raises:
            MissingDependency: Pinocchio is not installed.
            InvalidSetup: The base does not carry the TCP, or a joint is of another kind.
        """
        super().__init__()
        self._pin = package_of("pinocchio", "pinocchio", "backend='pinocchio' needs")
        self.model, self.frame, self._order = _chain(self._pin, model, joints, tcp_site, base_body)
        """Pinocchio's model of the chain, and in it the number of the frame at the TCP."""
        limited = model.jnt_limited[joints].astype(bool)
        self._lower = np.where(limited, model.jnt_range[joints, 0], -2 * np.pi)
        self._upper = np.where(limited, model.jnt_range[joints, 1], 2 * np.pi)
        self._own = threading.local()  # Pinocchio's data, one per thread

    def _dof(self) -> int:
        return len(self._order)

    def _joint_lower(self) -> list[float]:
        return self._lower.tolist()

    def _joint_upper(self) -> list[float]:
        return self._upper.tolist()

    def _forward(self, joints: Vector) -> Pose:
        placement = self._place(joints)
        return Pose(placement.translation, self._pin.Quaternion(placement.rotation).coeffs())

    def _jacobian(self, joints: Vector) -> Vector:
        local = self._pin.LOCAL_WORLD_ALIGNED
        q = np.ascontiguousarray(joints[self._order])
        jacobian = np.zeros((6, len(q)))
        jacobian[:, self._order] = self._pin.computeFrameJacobian(self.model, self._data(), q, self.frame, local)
        return jacobian

    def _place(self, joints: Vector) -> Any:
        data = self._data()
        self._pin.framesForwardKinematics(self.model, data, np.ascontiguousarray(joints[self._order]))
        return data.oMf[self.frame]

    def _data(self) -> Any:
        if not hasattr(self._own, "data"):
            self._own.data = self.model.createData()
        return self._own.data


def _chain(
    pin: Any, model: mujoco.MjModel, joints: list[int], tcp_site: int, base_body: int
) -> tuple[Any, int, NDArray[np.intp]]:
    """Return Pinocchio's model of a chain, its frame at the TCP, and which given joint each of its joints is."""
    bodies: list[int] = []
    body = int(model.site_bodyid[tcp_site])
    while body != base_body:
        if body == 0:
            raise InvalidSetup("inverse kinematics: the base body does not carry the TCP")
        bodies.append(body)
        body = int(model.body_parentid[body])
    chain, parent, fixed = pin.Model(), 0, pin.SE3.Identity()
    order: list[int] = []
    for body in reversed(bodies):
        fixed = fixed * _placement(pin, model.body_pos[body], model.body_quat[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if joint not in joints:
                continue  # stays where the model has it
            kinds = {mujoco.mjtJoint.mjJNT_HINGE: pin.JointModelRevoluteUnaligned,
                     mujoco.mjtJoint.mjJNT_SLIDE: pin.JointModelPrismaticUnaligned}  # fmt: skip
            kind = mujoco.mjtJoint(model.jnt_type[joint])
            if kind not in kinds:
                raise InvalidSetup("inverse kinematics: only hinge and slide joints are supported")
            axis, anchor = np.array(model.jnt_axis[joint]), np.array(model.jnt_pos[joint])
            fixed = fixed * pin.SE3(np.eye(3), anchor)
            parent = chain.addJoint(parent, kinds[kind](axis), fixed, model.joint(joint).name)
            order.append(joints.index(joint))
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            is_hinge = kind == mujoco.mjtJoint.mjJNT_HINGE
            back = (
                pin.SE3(pin.exp3(-reference * axis), np.zeros(3)) if is_hinge else pin.SE3(np.eye(3), -reference * axis)
            )
            fixed = back * pin.SE3(np.eye(3), -anchor)
    if len(order) != len(joints):
        raise InvalidSetup("inverse kinematics: a joint does not move the TCP; with Pinocchio every joint must")
    tcp = fixed * _placement(pin, model.site_pos[tcp_site], model.site_quat[tcp_site])
    frame = chain.addFrame(pin.Frame("tcp", parent, tcp, pin.FrameType.OP_FRAME))
    return chain, int(frame), np.array(order)


def _placement(pin: Any, position: ArrayLike, wxyz: ArrayLike) -> Any:
    turn = pin.Quaternion(np.array(wxyz_to_xyzw(np.array(wxyz, np.float64)), np.float64)).normalized()
    return pin.SE3(turn.matrix(), np.array(position, np.float64))
