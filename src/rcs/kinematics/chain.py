"""The kinematic chain from a robot's base to its TCP, composed from descriptions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import DampedLeastSquares, IkOptions, Kinematics
from rcs.devices import lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.camera import CameraDescription
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, Description, GripperDescription, HandDescription, Mount
from rcs.spatial import xyzw_to_wxyz

GRIPPER_PREFIX = "gripper/"
"""Prefix of the names of the end effector, a gripper or a hand."""

POSE = 6
"""Number of joints that reach any pose near another."""
FOLLOWED = 1e-5
"""Tolerance of a followed pose [m] and [rad]: at 100 Hz, a target at 1 mm/s moves by this much per step."""
RANK = 1e-4
"""Part of the largest mobility of a TCP below which it cannot move that way: arms of five joints."""

EndEffector = GripperDescription | HandDescription
"""An end effector."""

Backend = Literal["mujoco", "pinocchio"]
"""The built-in solver on the chain of MuJoCo's model, or Pinocchio, an extra, on the same chain."""


def load(description: Description) -> mujoco.MjSpec:
    """Read the MJCF file or URDF of a description, and complete it if the description can.

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


def kinematics_of(
    arm: ArmDescription | str, gripper: EndEffector | str | None = None, *, backend: Backend = "mujoco"
) -> Kinematics:
    """Make the kinematics of an arm: of its TCP with a gripper, of its flange without.

    Args:
        arm: The arm, or its name.
        gripper: The gripper or hand at its flange, or its name.
        backend: `mujoco` for the built-in chain; `pinocchio` for Pinocchio's, an extra.

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
    model, site = _model_of(of_arm, of_gripper)
    # The limits that devices and action spaces check; the file may allow more.
    for name, *limits in zip(of_arm.joints, of_arm.joint_lower, of_arm.joint_upper, strict=True):
        model.joint(name).range[:] = limits
        model.jnt_limited[model.joint(name).id] = True
    joints = [model.joint(name).id for name in of_arm.joints]
    base = model.body(of_arm.base_body).id
    if backend == "mujoco":
        return DampedLeastSquares(model, joints, site, base)
    from rcs.kinematics.pinocchio import PinocchioKinematics

    return PinocchioKinematics(model, joints, site, base)


def _model_of(arm: ArmDescription, effector: EndEffector | None) -> tuple[mujoco.MjModel, int]:
    """Return the model of an arm with its end effector, and the id of the site at its TCP, or at its flange."""
    spec, tcp = load(arm), arm.flange_site
    if effector is not None:
        attach_end_effector(spec, arm, effector)
        tcp = GRIPPER_PREFIX + effector.tcp_site
    model = compiled(spec, [arm] if effector is None else [arm, effector])
    return model, model.site(tcp).id


def freedom_of(
    kinematics: Kinematics,
    *,
    restarts: int = 0,
    best_effort: bool = False,
    preferred: ArrayLike | None = None,
    max_step: ArrayLike | None = None,
) -> IkOptions:
    """Return solver options for what an arm can reach: any pose, or with fewer than six joints, a position.

    The tool of an arm with fewer than six joints leans as little as possible, by up to 1.6 rad. An arm with more than
    six returns to its preferred joints while its TCP moves.

    Args:
        kinematics: Kinematics of the arm.
        restarts: Random starts if the target is not reached from the start; 0 keeps to the branch of the start.
        best_effort: Whether to follow a target that is out of reach as near as possible.
        preferred: Joints to return to [rad], shape (dof,); None for none. Arms with six joints or fewer have no choice.
        max_step: Largest change of each joint from the start [rad], shape (dof,); None for no bound.
    """
    has_spare = preferred is not None and kinematics.dof > POSE
    preferred = np.asarray(preferred, np.float64) if has_spare else None
    step = None if max_step is None else np.asarray(max_step, np.float64)
    if kinematics.dof >= POSE:
        # A slow target must not leave a wide tolerance before the joints follow with a jump.
        tolerance = FOLLOWED if best_effort else IkOptions().translation_tolerance
        return IkOptions(
            restarts=restarts,
            iterations=100,
            translation_tolerance=tolerance,
            rotation_tolerance=tolerance,
            best_effort=best_effort,
            preferred=preferred,
            max_step=step,
        )
    # With this weight, a tilt of a right angle moves the solution by less than the tolerance of the position. Damping
    # that is not small against its square lets the tilt creep to its best, a few percent of the way at a time. A search
    # from random starts takes that: with less damping it finds fewer solutions.
    return IkOptions(
        restarts=restarts,
        iterations=200,
        rotation_weight=0.005,
        damping=1e-6 if best_effort else IkOptions().damping,
        rotation_tolerance=1.6,
        translation_tolerance=5e-4,
        best_effort=best_effort,
        max_step=step,
    )


def damped(compliance: Compliance, arm: ArmDescription, effector: EndEffector | None) -> Compliance:
    """Return a compliance with a number for each joint of an arm or the six of its TCP, and with its damping.

    The default is the critical damping of each spring with the inertia that it feels at home while the others hold.

    Args:
        compliance: The compliance, with or without damping.
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
    model, tcp = _model_of(arm, effector)
    data = mujoco.MjData(model)
    for name, position in zip(arm.joints, arm.home, strict=True):
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    unit, inertia = np.eye(model.nv)[dofs], np.zeros((arm.dof, model.nv))
    for row, one in zip(inertia, unit, strict=True):
        mujoco.mj_mulM(model, data, row, one)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], tcp)
    base = data.body(arm.base_body).xmat.reshape(3, 3).T
    jacobian = np.concatenate([base @ jacobian[:3], base @ jacobian[3:]])
    return inertia[:, dofs], jacobian[:, dofs]
