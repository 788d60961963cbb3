"""No task: a robot, a table, and a board of AprilTags, on the table or on the gripper."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np

from rcs.calibration import Board
from rcs.errors import InvalidSetup
from rcs.sim.scene import RobotPlacement, Scene
from rcs.spatial import Pose, xyzw_to_wxyz
from rcs.tasks.free import Free

BOARD = "board"
"""Name of the board's body, geom, material and texture."""
THICKNESS = 0.003
"""Thickness of the board [m]."""
PIXELS_PER_CELL = 32
"""Pixels of the texture per cell of a tag."""


class ShowBoardOptions(Free.Options):
    """Where which board is. The pose is that of its middle, z out of the printed side."""

    rows: int = Board.rows
    """Rows of tags."""
    columns: int = Board.columns
    """Columns of tags."""
    tag_size: float = Board.tag_size
    """Edge of a tag's black square [m]."""
    gap: float = Board.gap
    """White between two tags [m]."""
    first_id: int = Board.first_id
    """Number of the tag at the top left."""
    on: Literal["scene", "gripper"] = "scene"
    """What carries the board, and in whose frame its pose is: the scene, or the base body of the first robot's
    gripper."""
    x: float = 0.5
    """x of its middle [m]."""
    y: float = 0.0
    """y of its middle [m]."""
    z: float = THICKNESS
    """z of its middle [m]."""
    roll: float = 0.0
    """Angle about the fixed x axis [rad]."""
    pitch: float = 0.0
    """Angle about the fixed y axis [rad]."""
    yaw: float = 0.0
    """Angle about the fixed z axis [rad]."""

    @property
    def board(self) -> Board:
        """The board."""
        return Board(rows=self.rows, columns=self.columns, tag_size=self.tag_size, gap=self.gap, first_id=self.first_id)

    @property
    def pose(self) -> Pose:
        """Its pose in what carries it."""
        return Pose.from_rpy([self.x, self.y, self.z], [self.roll, self.pitch, self.yaw])


class ShowBoard(Free):
    """A board to calibrate cameras with, true to scale."""

    Options = ShowBoardOptions
    options: ShowBoardOptions

    def furnish(self, scene: Scene) -> None:
        """Add a table, and the board if the scene carries it."""
        scene.add_table()
        if self.options.on == "scene":
            self._add_board(scene, scene.spec.worldbody)

    def equip(self, scene: Scene, robots: tuple[RobotPlacement, ...]) -> None:
        """Add the board to the gripper if that carries it; it touches the table, but not the gripper.

        Raises:
            InvalidSetup: The first robot has no end effector.
        """
        if self.options.on == "scene":
            return
        robot = robots[0]
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
            name=BOARD,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=picture.shape[1],
            height=picture.shape[0],
            nchannel=3,
        )
        texture.data = np.repeat(picture[..., None], 3, axis=-1).tobytes()
        material = spec.add_material(name=BOARD, specular=0.0, shininess=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = BOARD
        pose = options.pose
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
