"""The setup in which a camera of a lab is calibrated: robot, camera, and a board where the camera can see it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from rcs.calibration import Board
from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import kinematics_of
from rcs.robots.description import Mount
from rcs.setups.calibration import KnownBoard
from rcs.setups.lab import lab_of
from rcs.setups.mounted_camera import MountedCamera
from rcs.sim.scene import RobotPlacement, Scene
from rcs.spatial import Pose, xyzw_to_wxyz
from rcs.tasks.free import Free

BOARD = "board"
"""Name of the board's body, geom, material and texture."""
THICKNESS = 0.003
"""Thickness of the board [m]."""
PIXELS_PER_CELL = 32
"""Pixels of the texture per cell of a tag."""
HELD = 0.02
"""How much of a board's border is between the fingers of the gripper that holds it [m]."""
USUAL_SIZE = (640, 480)
"""Size of pictures of a camera without a calibration [px]."""


class ShowBoardOptions(Free.Options):
    """Where which board is."""

    board: Board = Board()
    """The board."""
    mount: Mount = Mount(translation=(0.5, 0.0, THICKNESS))
    """Pose of its middle in the frame of what carries it, z out of the printed side."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body carries it; None for the scene."""


class ShowBoard(Free):
    """A board to calibrate cameras with, true to scale."""

    Options = ShowBoardOptions
    options: ShowBoardOptions

    def furnish(self, scene: Scene) -> None:
        """Add a table, and the board if the scene carries it."""
        scene.add_table()
        if self.options.on_gripper_of is None:
            self._add_board(scene, scene.spec.worldbody)

    def equip(self, scene: Scene, robots: tuple[RobotPlacement, ...]) -> None:
        """Add the board to the gripper if one carries it; it touches the table, but not the gripper.

        Raises:
            UnknownName: There is no such robot.
            InvalidSetup: The robot has no end effector.
        """
        if (name := self.options.on_gripper_of) is None:
            return
        by_name = {robot.name: robot for robot in robots}
        if (robot := by_name.get(name)) is None:
            raise UnknownName("robot of this setup", name, by_name)
        if robot.end_effector is None:
            raise InvalidSetup(f"A board on the gripper of {robot.name!r} needs one; it has a bare flange.")
        parent = robot.gripper_prefix + robot.end_effector.base_body
        self._add_board(scene, scene.spec.body(parent))
        for body in scene.spec.bodies:
            if body.name.startswith(robot.gripper_prefix):
                scene.spec.add_exclude(bodyname1=BOARD, bodyname2=body.name)

    def _add_board(self, scene: Scene, parent: mujoco.MjsBody) -> None:
        spec, options = scene.spec, self.options
        width, height = options.board.size
        picture = options.board.picture(PIXELS_PER_CELL)
        texture = spec.add_texture(
            name=BOARD, type=mujoco.mjtTexture.mjTEXTURE_2D, width=picture.shape[1], height=picture.shape[0], nchannel=3
        )
        texture.data = np.repeat(picture[..., None], 3, axis=-1).tobytes()
        material = spec.add_material(name=BOARD, specular=0.0, shininess=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = BOARD
        pose = options.mount.pose
        body = parent.add_body(name=BOARD, pos=pose.translation, quat=xyzw_to_wxyz(pose.quaternion))
        body.add_geom(
            name=BOARD,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[width / 2, height / 2, THICKNESS / 2],
            pos=[0.0, 0.0, -THICKNESS / 2],
            mass=1e-3,
            material=BOARD,
            group=0,
        )


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
        image_size: Size of the pictures [px]; None for that of the camera's calibration.

    Raises:
        UnknownName: There is no such robot or camera.
        InvalidSetup: The camera cannot be calibrated with this robot, or the carrier of the board `at` does not fit it.
    """
    setup = Setup(
        task="rcs.setups.board_setup:ShowBoard",
        robot=robot,
        cameras=Cameras(names=camera, calibration=calibration, image_size=image_size or USUAL_SIZE),
        relative="absolute",
        stepping="sync",
        max_episode_steps=None,
    )
    mounted = MountedCamera.of(setup, camera, None if at is None else at.on_gripper_of)
    held_by = mounted.robot.name if mounted.arrangement == "eye-to-hand" else None
    if at is not None and at.on_gripper_of != held_by:
        raise InvalidSetup(
            f"The board of camera {camera!r} has on_gripper_of={at.on_gripper_of!r}; valid is the name of a robot for "
            "a camera that stands still, and None, a board in the scene, for one on a gripper."
        )
    seen = None if mounted.camera.calibration is None else mounted.camera.calibration.intrinsics
    if seen is not None and image_size is None:
        setup = replace(setup, cameras=replace(setup.cameras, image_size=(seen.width, seen.height)))
    known = at or KnownBoard(board=board or Board(), mount=_place(robot, mounted, board or Board()))
    options = ShowBoardOptions(board=known.board, mount=known.mount, on_gripper_of=held_by)
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
