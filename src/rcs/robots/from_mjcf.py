"""An arm's description from its model file: what the file has need not be written twice."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription

HOME = "home"
"""Name of the keyframe with the rest pose."""


def arm_from_mjcf(
    path: str | Path,
    *,
    velocity_limit: float | Sequence[float],
    acceleration_limit: float | Sequence[float],
    jerk_limit: float | Sequence[float],
    home: Sequence[float] | None = None,
    name: str | None = None,
    flange_site: str = "flange",
    **figures: Any,
) -> ArmDescription:
    """Return the description of an arm whose joints, position actuators, ranges and efforts are those of an MJCF file.

    Args:
        path: The file.
        velocity_limit: Largest joint speeds [rad/s]: one number for all joints, or one for each. A model has none.
        acceleration_limit: Largest joint accelerations [rad/s²], likewise.
        jerk_limit: Largest joint jerks [rad/s³], likewise.
        home: Joint positions of the rest pose [rad]; None for those of the keyframe `home`.
        name: Short name; None for that of the file.
        flange_site: Site where a gripper is attached.
        figures: More fields of `ArmDescription`, such as `tcp_speed` or `collision`.

    Raises:
        InvalidSetup: The file cannot be read, or lacks a position actuator, a limit, the rest pose or the flange.
    """
    import mujoco

    file = Path(path).resolve()
    try:
        model = mujoco.MjModel.from_xml_path(str(file))
    except (ValueError, OSError) as err:
        raise InvalidSetup(f"{path} cannot be read: {err}") from err
    actuators = [model.actuator(i) for i in range(model.nu) if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT]
    if not actuators:
        raise InvalidSetup(f"{path} has no actuators of joints; an arm has a position actuator for each joint.")
    # As MuJoCo compiles <position>, also with kv or dampratio: force = kp * (target - joint) - kv * velocity.
    if others := [one.name for one in actuators if not one.gainprm[0] == -one.biasprm[1] > 0.0]:
        raise InvalidSetup(f"{path}: the actuators {others} are no position actuators; use <position>.")
    joints = [model.joint(actuator.trnid[0]) for actuator in actuators]
    if unlimited := [joint.name for joint in joints if not model.jnt_limited[joint.id]]:
        raise InvalidSetup(f"{path}: the joints {unlimited} have no range; give each range='lower upper'.")
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, flange_site) < 0:
        sites = [model.site(i).name for i in range(model.nsite)]
        raise InvalidSetup(f"{path} has no site {flange_site!r} but {sites}; name the one at the flange: flange_site=…")
    if loose := _loose_joints(model, joints, flange_site):
        raise InvalidSetup(
            f"{path}: the joints {loose} between base and flange have no actuator; give each a <position>."
        )
    addresses = [int(joint.qposadr[0]) for joint in joints]
    if home is None and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, HOME) < 0:
        raise InvalidSetup(f"{path} has no keyframe {HOME!r}; give home=, the joints of the rest pose [rad].")
    rest = model.key(HOME).qpos[addresses].tolist() if home is None else tuple(home)
    count = len(joints)
    efforts = tuple(_effort(model, joint, actuator) for joint, actuator in zip(joints, actuators, strict=True))
    own: dict[str, Any] = {
        "name": name or file.stem,
        "label": name or file.stem,
        "mjcf_file": str(file),
        "base_body": model.body(model.body_rootid[joints[0].bodyid[0]]).name,
        "joints": tuple(joint.name for joint in joints),
        "actuators": tuple(actuator.name for actuator in actuators),
        "flange_site": flange_site,
        "home": rest,
        "joint_lower": tuple(joint.range[0] for joint in joints),
        "joint_upper": tuple(joint.range[1] for joint in joints),
        "velocity_limit": _each(velocity_limit, count),
        "acceleration_limit": _each(acceleration_limit, count),
        "jerk_limit": _each(jerk_limit, count),
        "effort_limit": efforts,
        "workspace_reach": _reach(model, joints, flange_site),
        "sources": (file.name,),
    }
    return ArmDescription(**{**own, **figures})


def _each(limit: float | Sequence[float], count: int) -> tuple[float, ...]:
    return (float(limit),) * count if isinstance(limit, int | float) else tuple(limit)


def _loose_joints(model: Any, joints: Sequence[Any], flange_site: str) -> list[str]:
    """Return the hinge and slide joints from the base to the flange that are not among those with an actuator."""
    import mujoco

    driven, body, bodies = {joint.id for joint in joints}, int(model.site(flange_site).bodyid[0]), set[int]()
    while body:
        bodies.add(body)
        body = int(model.body_parentid[body])
    kinds = mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value
    return [
        model.joint(i).name
        for i in range(model.njnt)
        if int(model.jnt_bodyid[i]) in bodies and int(model.jnt_type[i]) in kinds and i not in driven
    ]


def _effort(model: Any, joint: Any, actuator: Any) -> float:
    """Return the largest torque of a joint [Nm]."""
    for is_limited, limits in (
        (model.jnt_actfrclimited[joint.id], model.jnt_actfrcrange[joint.id]),
        (model.actuator_forcelimited[actuator.id], model.actuator_forcerange[actuator.id]),
    ):
        if is_limited:
            return float(limits[1])
    raise InvalidSetup(f"The joint {joint.name!r} has no largest torque; give it actfrcrange, or a forcerange.")


def _reach(model: Any, joints: Sequence[Any], flange_site: str) -> float:
    """Return the length of the stretched arm from its second joint to the flange [m]."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = [data.xanchor[joint.id] for joint in joints[1:]] or [data.xanchor[joints[0].id]]
    points.append(data.site(flange_site).xpos)
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))
