"""The kinematic chain from a robot's base to its TCP, composed from descriptions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, get_args, overload

import mujoco

from rcs._core import DampedLeastSquares, Kinematics
from rcs.devices import lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.description import (
    ArmDescription,
    CameraDescription,
    Description,
    GripperDescription,
    HandDescription,
    Mount,
)
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

    Raises:
        InvalidSetup: The file cannot be read.
        UnknownName: The file lacks a body, site, joint, actuator or geom that the description names.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(description.mjcf))
    except ValueError as err:
        raise InvalidSetup(f"{description.name}: {description.mjcf} cannot be read: {_one_line(err)}") from err
    for element in [*spec.lights, *spec.worldbody.geoms]:
        spec.delete(element)
    if isinstance(description, ArmDescription) and description.complete is not None:
        description.complete(spec)
    _require_names(description, spec)
    return spec


def compiled(spec: mujoco.MjSpec, parts: Iterable[Description]) -> mujoco.MjModel:
    """Compile a model.

    Args:
        spec: The model.
        parts: Descriptions whose files it is made of.

    Raises:
        InvalidSetup: It cannot be compiled; the message names the file at fault, if it is one of these.
    """
    try:
        return spec.compile()
    except ValueError as err:
        for part in parts:
            try:
                load(part).compile()
            except ValueError as own:
                raise InvalidSetup(f"{part.name}: {part.mjcf} cannot be compiled: {_one_line(own)}") from own
        raise InvalidSetup(f"The scene cannot be compiled: {_one_line(err)}") from err


def _require_names(description: Description, spec: mujoco.MjSpec) -> None:
    wanted: dict[str, Sequence[str]] = {"body": [description.base_body]}
    if isinstance(description, ArmDescription):
        wanted |= {"site": [description.flange_site], "joint": description.joints, "actuator": description.actuators}
    elif isinstance(description, GripperDescription):
        wanted |= {"site": [description.tcp_site], "joint": description.joints, "actuator": [description.actuator]}
        wanted["geom"] = [name for pads in description.pad_geoms for name in pads]
    elif isinstance(description, HandDescription):
        wanted |= {"site": [description.tcp_site], "joint": description.joints, "actuator": description.actuators}
        wanted["geom"] = [name for pads in description.finger_geoms.values() for name in pads]
    elif isinstance(description, CameraDescription):
        wanted["camera"] = [description.camera]
    there = {"body": spec.bodies, "site": spec.sites, "joint": spec.joints, "actuator": spec.actuators,
             "geom": spec.geoms, "camera": spec.cameras}  # fmt: skip
    for kind, names in wanted.items():
        known = [element.name for element in there[kind] if element.name]
        for name in names:
            if name not in known:
                hint = f"The description {description.name!r} names it, and its file is {description.mjcf}."
                raise UnknownName(kind, name, known, hint)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


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
    arm: ArmDescription | str, gripper: EndEffector | str | None = None, *, backend: Literal["mujoco"] = "mujoco"
) -> DampedLeastSquares: ...
@overload
def kinematics_of(
    arm: ArmDescription | str, gripper: EndEffector | str | None = None, *, backend: Backend
) -> Kinematics: ...
def kinematics_of(
    arm: ArmDescription | str, gripper: EndEffector | str | None = None, *, backend: Backend = "mujoco"
) -> Kinematics:
    """Make the kinematics of an arm: of its TCP with a gripper, of its flange without.

    Args:
        arm: The arm, or its name.
        gripper: The gripper or hand at its flange, or its name.
        backend: `mujoco` for the built-in solver; `pinocchio` for a slower one, an extra.

    Returns:
        A new solver, which several threads may use.

    Raises:
        InvalidSetup: There is no such backend, or a file cannot be read or compiled.
        UnknownName: A file lacks something that its description names.
        MissingDependency: Pinocchio is not installed.
    """
    if backend not in get_args(Backend):
        raise InvalidSetup(f"backend is {backend!r}; valid: {', '.join(map(repr, get_args(Backend)))}.")
    of_arm: ArmDescription = lookup.find("arm", arm)
    kind = "hand" if gripper in lookup.names("hand") else "gripper"
    of_gripper: EndEffector | None = lookup.find(kind, gripper)
    spec = load(of_arm)
    tcp = of_arm.flange_site
    if of_gripper is not None:
        attach_end_effector(spec, of_arm, of_gripper)
        tcp = GRIPPER_PREFIX + of_gripper.tcp_site
    model = compiled(spec, [of_arm] if of_gripper is None else [of_arm, of_gripper])
    # What devices and action spaces check; the file may allow more.
    for name, *limits in zip(of_arm.joints, of_arm.joint_lower, of_arm.joint_upper, strict=True):
        model.joint(name).range[:] = limits
        model.jnt_limited[model.joint(name).id] = True
    joints = [model.joint(name).id for name in of_arm.joints]
    site, base = model.site(tcp).id, model.body(of_arm.base_body).id
    if backend == "mujoco":
        return DampedLeastSquares(model, joints, site, base)
    from rcs.kinematics.pinocchio import PinocchioKinematics

    return PinocchioKinematics(model, joints, site, base)
