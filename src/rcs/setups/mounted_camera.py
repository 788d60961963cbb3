"""A camera of a setup as a rig that can be calibrated, and back: frames of labs and files to those of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

from rcs.calibration import Board, HandEye, Rig
from rcs.calibration.rig import Arrangement
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import kinematics_of
from rcs.robots.camera import Calibration
from rcs.robots.description import Mount
from rcs.setups.calibration import KnownBoard
from rcs.setups.make import resolve
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.spatial import Intrinsics, Pose

SCENE = "world"
"""Body that carries cameras that stand still."""


@dataclass(frozen=True, kw_only=True)
class MountedCamera:
    """A camera and the robot with which it is calibrated."""

    camera: CameraPlacement
    """The camera."""
    robot: RobotPlacement
    """The robot that carries it, or that shows it the board."""

    @staticmethod
    def of(setup: Setup, camera: str, robot: str | None = None) -> MountedCamera:
        """Return a camera of a setup.

        Args:
            setup: The setup.
            camera: Name of the camera.
            robot: Name of the robot that shows the board to a camera that stands still, where there are several; None
                for the one that carries the camera, or the first.

        Raises:
            UnknownName: There is no such camera or robot in the setup.
            InvalidSetup: The camera is fixed to a part of the robot other than its gripper, or to another robot's.
        """
        parts = resolve(setup)
        cameras = {one.name: one for one in parts.cameras}
        if camera not in cameras:
            raise UnknownName("camera of this setup", camera, cameras)
        robots = {one.name: one for one in parts.robots}
        if robot is not None and robot not in robots:
            raise UnknownName("robot of this setup", robot, robots)
        parent = cameras[camera].parent_body
        carrying = [one for one in parts.robots if parent == _gripper_body(one)]
        if parent != SCENE and not carrying:
            raise InvalidSetup(
                f"Camera {camera!r} is fixed to {parent!r}; calibrated are cameras on a gripper and in the scene."
            )
        if carrying and robot not in (None, carrying[0].name):
            raise InvalidSetup(f"Camera {camera!r} is on the gripper of {carrying[0].name!r}, not of {robot!r}.")
        chosen = carrying[0] if carrying else parts.robots[0] if robot is None else robots[robot]
        if not carrying and _gripper_body(chosen) is None:
            raise InvalidSetup(f"The board is to be on the gripper of {chosen.name!r}, which has none.")
        return MountedCamera(camera=cameras[camera], robot=chosen)

    @property
    def arrangement(self) -> Arrangement:
        """Place of the camera: on the gripper ("eye-in-hand") or beside the robot ("eye-to-hand")."""
        return "eye-to-hand" if self.camera.parent_body == SCENE else "eye-in-hand"

    def rig(self, intrinsics: Intrinsics, board: Pose | None = None) -> Rig:
        """Return the rig.

        Args:
            intrinsics: Intrinsics of the pictures that are looked at.
            board: About where the board is, in the scene (camera on the gripper), or in the base body of the gripper;
                None if nobody knows.
        """
        of_camera, of_board = self._carriers()
        return Rig(
            kinematics=kinematics_of(self.robot.arm),
            arrangement=self.arrangement,
            intrinsics=intrinsics,
            camera_in_mount=of_camera * self.camera.optical_in_parent.pose,
            board_in_anchor=None if board is None else of_board * board,
        )

    def calibration(self, found: HandEye, intrinsics: Intrinsics) -> Calibration:
        """Return what a calibration file says of the camera.

        Args:
            found: Where it is.
            intrinsics: How it sees.
        """
        rows = [[float(value) for value in row] for row in found.covariance]
        return Calibration(
            optical=Mount.of(self._carriers()[0].inverse() * found.camera_in_mount),
            intrinsics=intrinsics,
            pose_covariance=tuple(map(tuple, rows)),
        )

    def known_board(self, found: HandEye, board: Board) -> KnownBoard:
        """Return where the board is, as a calibration file says it."""
        return KnownBoard(
            board=board,
            mount=Mount.of(self._carriers()[1].inverse() * found.board_in_anchor),
            on_gripper_of=None if self.arrangement == "eye-in-hand" else self.robot.name,
        )

    def _carriers(self) -> tuple[Pose, Pose]:
        """Return the poses of what carries camera and board in the setup, in what carries them in the rig.

        One is that of the gripper in the flange, the other that of the scene in the base.
        """
        assert self.robot.end_effector is not None, "the camera or the board is on it"
        gripper, scene = self.robot.end_effector.mount_in_flange.pose, self.robot.base_in_scene.pose.inverse()
        return (gripper, scene) if self.arrangement == "eye-in-hand" else (scene, gripper)


def _gripper_body(robot: RobotPlacement) -> str | None:
    return None if robot.end_effector is None else robot.gripper_prefix + robot.end_effector.base_body
