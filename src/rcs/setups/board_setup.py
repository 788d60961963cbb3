"""The setup in which a camera of a lab is calibrated: robot, camera, and a board where the camera can see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rcs.calibration import Board
from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.kinematics import kinematics_of
from rcs.robots.description import Mount
from rcs.setups.calibration import KnownBoard
from rcs.setups.lab import lab_of
from rcs.setups.mounted_camera import MountedCamera
from rcs.spatial import Pose
from rcs.tasks.show_board import THICKNESS, ShowBoardOptions

HELD = 0.02
"""How much of a board's border is between the fingers of the gripper that holds it [m]."""
USUAL_SIZE = (640, 480)
"""Size of pictures of a camera without a calibration [px]."""


def board_setup(
    robot: str,
    camera: str,
    board: Board | None = None,
    *,
    at: KnownBoard | None = None,
    calibration: str | None = None,
    image_size: tuple[int, int] | None = None,
) -> Setup:
    """Return the setup.

    Without `at`, a board for a camera on a gripper lies in the middle of the workspace, and one for a camera that
    stands still is held by the gripper, upright, and faces the camera where the robot is at home. In simulation it is
    there; on hardware it should be about there.

    Args:
        robot: Name of the robot.
        camera: Name of the camera.
        board: The board; None for the usual one.
        at: A board and its place, instead.
        calibration: Calibration file of the cameras; None for those of the lab.
        image_size: Of the pictures [px]; None for that of the camera's calibration.

    Raises:
        UnknownName: There is no such robot or camera.
        InvalidSetup: The camera cannot be calibrated with this robot.
    """
    setup = Setup(
        task="rcs.tasks.show_board:ShowBoard",
        robot=robot,
        cameras=Cameras(names=camera, calibration=calibration, image_size=image_size or USUAL_SIZE),
        relative="absolute",
        stepping="sync",
        max_episode_steps=None,
    )
    mounted = MountedCamera.of(setup, camera)
    seen = None if mounted.camera.calibration is None else mounted.camera.calibration.intrinsics
    if seen is not None and image_size is None:
        setup = replace(setup, cameras=replace(setup.cameras, image_size=(seen.width, seen.height)))
    known = at or KnownBoard(board=board or Board(), mount=_place(robot, mounted, board or Board()))
    is_held = known.on_gripper_of is not None if at is not None else mounted.arrangement == "eye-to-hand"
    pose = known.mount.pose
    (x, y, z), (roll, pitch, yaw) = (tuple(float(value) for value in part) for part in (pose.translation, pose.rpy))
    options = ShowBoardOptions(
        **known.board.to_json(),
        on="gripper" if is_held else "scene",
        x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw,
    )  # fmt: skip
    return replace(setup, task_options=options.to_json())


def _place(robot: str, mounted: MountedCamera, board: Board) -> Mount:
    if mounted.arrangement == "eye-in-hand":
        x, y = lab_of(robot).area.center
        return Mount(translation=(x, y, THICKNESS))
    held_by = mounted.robot
    assert held_by.end_effector is not None, "MountedCamera has checked it"
    flange = kinematics_of(held_by.arm).forward(np.array(held_by.arm.home, np.float64))
    gripper = held_by.base_in_scene.pose * flange * held_by.end_effector.mount_in_flange.pose
    tcp = held_by.end_effector.tcp_in_base.pose
    along = tcp.matrix[:3, 2]  # the TCP frame's z axis is the direction of approach
    eye = (gripper.inverse() * mounted.camera.optical_in_parent.pose).translation - tcp.translation
    normal = eye - along * (eye @ along)
    normal = normal / np.linalg.norm(normal) if np.linalg.norm(normal) > 1e-6 else tcp.matrix[:3, 0]
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([np.cross(-along, normal), -along, normal])
    matrix[:3, 3] = tcp.translation + along * (board.size[1] / 2 - HELD) + normal * THICKNESS / 2
    return Mount.of(Pose.from_matrix(matrix))
