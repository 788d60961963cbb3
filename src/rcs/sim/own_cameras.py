"""Cameras that a robot's own model file defines, as placements like those of a lab."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from rcs.errors import InvalidSetup
from rcs.kinematics.chain import load
from rcs.robots.description import CameraDescription, Description, Mount, ResolutionMode
from rcs.robots.pinhole.description import PINHOLE, RATES
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.spatial import Pose, wxyz_to_xyzw

CAMERA_IN_OPTICAL = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
"""MuJoCo's cameras look along -z with y up, the optical frame has z forward and y down: half a turn about x."""


def cameras_of(robots: Sequence[RobotPlacement]) -> dict[str, CameraPlacement]:
    """Return the cameras that the files of arms and end effectors define, by name.

    A camera is fixed to its body at the pose that the file says, with the file's `fovy`, or the one that follows from
    `focal` and `sensorsize`. With several robots, `<robot>_` stands before its name. Cameras without a name are left
    out.

    Args:
        robots: The robots of a scene.

    Raises:
        InvalidSetup: Two cameras have the same name, or one of them turns by itself or is not an ideal one.
    """
    found: dict[str, CameraPlacement] = {}
    for robot in robots:
        parts = [(robot.prefix, robot.arm), (robot.gripper_prefix, robot.end_effector)]
        for prefix, part in parts:
            for name, camera in () if part is None else _cameras_in(part, prefix):
                known = name if len(robots) == 1 else f"{robot.name}_{name}"
                if known in found:
                    raise InvalidSetup(f"Robot {robot.name!r} has two cameras named {name!r}; rename one in its file.")
                found[known] = replace(camera, name=known)
    return found


def _cameras_in(part: Description, prefix: str) -> Iterator[tuple[str, CameraPlacement]]:
    """Yield the cameras in the file of a part, with a prefix before their names."""
    spec = load(part)
    if not spec.cameras:
        return
    model = spec.compile()
    for i in range(model.ncam):
        if not (name := model.camera(i).name.replace("/", "_")):
            continue
        if model.cam_mode[i] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            raise InvalidSetup(f"Camera {name!r} in {part.mjcf_file} turns by itself; valid is mode='fixed'.")
        if model.cam_intrinsic[i, 2:].any() or model.cam_projection[i] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
            raise InvalidSetup(
                f"Camera {name!r} in {part.mjcf_file} is orthographic or its principal point is not in the middle of "
                "the image; drawn are perspective images about their middle."
            )
        # A camera in the file's world moves with the base, which has no pose there.
        body = model.body(int(model.cam_bodyid[i])).name if model.cam_bodyid[i] else part.base_body
        optical = Pose(model.cam_pos[i], wxyz_to_xyzw(model.cam_quat[i])) * CAMERA_IN_OPTICAL
        camera = _description(name, model, i)
        yield (
            name,
            CameraPlacement(
                name=name,
                camera=camera,
                parent_body=prefix + body,
                optical_in_parent=Mount.of(optical),
            ),
        )


def _description(name: str, model: mujoco.MjModel, i: int) -> CameraDescription:
    width, height = (int(edge) for edge in model.cam_resolution[i])
    camera = replace(PINHOLE, name=name, label=f"Camera {name}", fovy=float(np.deg2rad(model.cam_fovy[i])))
    if width == 1:  # the file gives no resolution
        return camera
    return replace(camera, native_aspect=width / height, modes=(ResolutionMode(width, height, RATES),))
