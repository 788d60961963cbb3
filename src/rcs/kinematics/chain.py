"""The kinematic chain from a robot's base to its TCP, composed from descriptions."""

from __future__ import annotations

from typing import Literal, get_args, overload

import mujoco

from rcs._core import DampedLeastSquares, Kinematics
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription, Description, GripperDescription, HandDescription, Mount
from rcs.spatial import xyzw_to_wxyz

GRIPPER_PREFIX = "gripper/"
"""Prefix of the names of the end effector, a gripper or a hand."""

EndEffector = GripperDescription | HandDescription
"""An end effector."""

Backend = Literal["mujoco", "pinocchio"]
"""Who computes: the built-in solver on the chain of MuJoCo's model, or Pinocchio on the same chain, an extra."""


def load(description: Description) -> mujoco.MjSpec:
    """Read the MJCF file or URDF of a description, and complete it if the description says how.

    Lights and geoms of the file's world, such as a floor, are left out; otherwise they would appear in every scene.
    """
    spec = mujoco.MjSpec.from_file(str(description.mjcf))
    for element in [*spec.lights, *spec.worldbody.geoms]:
        spec.delete(element)
    if isinstance(description, ArmDescription) and description.complete is not None:
        description.complete(spec)
    return spec


def attach_end_effector(arm_spec: mujoco.MjSpec, arm: ArmDescription, gripper: EndEffector) -> None:
    """Fix a gripper or a hand to the flange of an arm; its names get the prefix `gripper/`.

    Args:
        arm_spec: Model of the arm, changed in place.
        arm: Description of the arm.
        gripper: Description of the gripper or hand.
    """
    on_flange = flange_frame(arm_spec, arm)
    mounted = mount_frame(on_flange.parent, gripper.mount_in_flange, inside=on_flange)
    arm_spec.attach(load(gripper), frame=mounted, prefix=GRIPPER_PREFIX)


def flange_frame(arm_spec: mujoco.MjSpec, arm: ArmDescription) -> mujoco.MjsFrame:
    """Add a frame at the flange of an arm, to the body that has the flange."""
    flange = arm_spec.site(arm.flange_site)
    frame = flange.parent.add_frame(pos=flange.pos, quat=quaternion_of(flange, arm_spec))
    if flange.frame is not None:
        frame.set_frame(flange.frame)
    return frame


def quaternion_of(element: mujoco.MjsSite | mujoco.MjsGeom, spec: mujoco.MjSpec) -> list[float]:
    """Return the orientation (wxyz) of an element, in whichever way its file gives it."""
    if element.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return list(element.quat)
    return spec.resolve_orientation(spec.compiler.degree, spec.compiler.eulerseq, element.alt)


def mount_frame(body: mujoco.MjsBody, mount: Mount, *, inside: mujoco.MjsFrame | None = None) -> mujoco.MjsFrame:
    """Add a frame to a body at a mount, relative to the body or to another frame of it."""
    frame = body.add_frame(pos=list(mount.translation), quat=list(xyzw_to_wxyz(mount.quaternion)))
    if inside is not None:
        frame.set_frame(inside)
    return frame


@overload
def kinematics_of(
    arm: ArmDescription, gripper: EndEffector | None = None, *, backend: Literal["mujoco"] = "mujoco"
) -> DampedLeastSquares: ...
@overload
def kinematics_of(arm: ArmDescription, gripper: EndEffector | None = None, *, backend: Backend) -> Kinematics: ...
def kinematics_of(
    arm: ArmDescription, gripper: EndEffector | None = None, *, backend: Backend = "mujoco"
) -> Kinematics:
    """Make the kinematics of an arm: of its TCP with a gripper, of its flange without.

    Args:
        arm: The arm.
        gripper: The gripper or hand at its flange.
        backend: `mujoco` for the built-in solver; `pinocchio` for a slower one, an extra.

    Returns:
        A new solver, which several threads may use.

    Raises:
        InvalidSetup: There is no such backend.
        MissingDependency: Pinocchio is not installed.
    """
    if backend not in get_args(Backend):
        raise InvalidSetup(f"backend is {backend!r}; valid: {', '.join(map(repr, get_args(Backend)))}.")
    spec = load(arm)
    tcp = arm.flange_site
    if gripper is not None:
        attach_end_effector(spec, arm, gripper)
        tcp = GRIPPER_PREFIX + gripper.tcp_site
    model = spec.compile()
    # What devices and action spaces check; the file may allow more.
    for name, *limits in zip(arm.joints, arm.joint_lower, arm.joint_upper, strict=True):
        model.joint(name).range[:] = limits
        model.jnt_limited[model.joint(name).id] = True
    joints = [model.joint(name).id for name in arm.joints]
    site, base = model.site(tcp).id, model.body(arm.base_body).id
    if backend == "mujoco":
        return DampedLeastSquares(model, joints, site, base)
    from rcs.kinematics.pinocchio import PinocchioKinematics

    return PinocchioKinematics(model, joints, site, base)
