"""A Franka controller's model of the arm: its URDF, and the inertia of its end effector.

Both are made from our descriptions, so the virtual arm's model equals the simulated one.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.hardware.franka_limits import DECELERATION_LIMIT, VELOCITY_OFFSET
from rcs.kinematics import load
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.spatial import Pose, wxyz_to_xyzw


def urdf_of(arm: ArmDescription) -> str:
    """Return the URDF of an arm, with links `link0` … `link8` (the flange) and joints `joint1` … ."""
    model = load(arm).compile()
    robot = ElementTree.Element("robot", name=arm.name)
    body = model.body(arm.base_body).id
    _link(robot, "link0", model, body)
    for index, name in enumerate(arm.joints):
        joint = model.joint(name)
        body, parent = int(joint.bodyid[0]), body
        assert model.body_parentid[body] == parent, "the bodies of an FR3 are one chain with a joint each"
        made = ElementTree.SubElement(robot, "joint", name=f"joint{index + 1}", type="revolute")
        _origin(made, model.body_pos[body], model.body_quat[body])
        ElementTree.SubElement(made, "parent", link=f"link{index}")
        ElementTree.SubElement(made, "child", link=f"link{index + 1}")
        ElementTree.SubElement(made, "axis", xyz=_text(joint.axis))
        ElementTree.SubElement(
            made,
            "limit",
            lower=_text([arm.joint_lower[index]]),
            upper=_text([arm.joint_upper[index]]),
            velocity=_text([arm.velocity_limit[index]]),
            effort=_text([arm.effort_limit[index]]),
        )
        ElementTree.SubElement(
            made,
            "position_based_velocity_limits",
            deceleration_limit=_text([DECELERATION_LIMIT[index]]),
            velocity_offset=_text([VELOCITY_OFFSET[index]]),
        )
        _link(robot, f"link{index + 1}", model, body)
    flange = model.site(arm.flange_site)
    fixed = ElementTree.SubElement(robot, "joint", name="joint8", type="fixed")
    _origin(fixed, flange.pos, flange.quat)
    ElementTree.SubElement(fixed, "parent", link=f"link{len(arm.joints)}")
    ElementTree.SubElement(fixed, "child", link="link8")
    ElementTree.SubElement(robot, "link", name="link8")
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True)


@dataclass(frozen=True, kw_only=True)
class Carried:
    """The inertia of an arm's end effector, as set in its controller."""

    mass: float
    """Mass [kg]."""
    center: NDArray[np.float64]
    """Centre of mass in the flange [m], shape (3,)."""
    inertia: NDArray[np.float64]
    """Inertia about the centre of mass, along the axes of the flange [kg·m²], shape (3, 3)."""
    pose_tcp_in_flange: Pose
    """Pose of the TCP in the flange."""

    @staticmethod
    def of(gripper: GripperDescription | None) -> Carried:
        """Return the inertia of a gripper with open fingers; None stands for a bare flange."""
        if gripper is None:
            return Carried(mass=0.0, center=np.zeros(3), inertia=np.zeros((3, 3)), pose_tcp_in_flange=Pose())
        model = load(gripper).compile()
        data = mujoco.MjData(model)
        for name, position in zip(gripper.joints, gripper.joint_open, strict=True):
            data.joint(name).qpos[:] = position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        base = data.body(gripper.base_body)
        pose_base_in_world = Pose(base.xpos, wxyz_to_xyzw(base.xquat))
        mount = gripper.mount_in_flange
        pose_world_in_flange = Pose(mount.translation, mount.quaternion) * pose_base_in_world.inverse()
        masses = model.body_mass[1:]
        mass = float(masses.sum())
        center = masses @ data.xipos[1:] / mass
        inertia = np.zeros((3, 3))
        for body in range(1, model.nbody):
            axes = data.ximat[body].reshape(3, 3)
            way = data.xipos[body] - center
            inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
            inertia += model.body_mass[body] * (way @ way * np.eye(3) - np.outer(way, way))
        rotation = pose_world_in_flange.matrix[:3, :3]
        tcp = gripper.tcp_in_base
        return Carried(
            mass=mass,
            center=pose_world_in_flange.apply(center),
            inertia=rotation @ inertia @ rotation.T,
            pose_tcp_in_flange=Pose(mount.translation, mount.quaternion) * Pose(tcp.translation, tcp.quaternion),
        )


def _link(robot: ElementTree.Element, name: str, model: mujoco.MjModel, body: int) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    _origin(inertial, model.body_ipos[body], model.body_iquat[body])
    ElementTree.SubElement(inertial, "mass", value=_text([model.body_mass[body]]))
    ixx, iyy, izz = model.body_inertia[body]
    ElementTree.SubElement(
        inertial, "inertia", ixx=_text([ixx]), iyy=_text([iyy]), izz=_text([izz]), ixy="0", ixz="0", iyz="0"
    )


def _origin(element: ElementTree.Element, translation: NDArray[np.float64], wxyz: NDArray[np.float64]) -> None:
    pose = Pose(translation, wxyz_to_xyzw(wxyz))
    ElementTree.SubElement(element, "origin", xyz=_text(pose.translation), rpy=_text(pose.rpy))


def _text(values: NDArray[np.float64] | list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
