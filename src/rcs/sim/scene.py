"""Composes a scene of robots, cameras and furniture into one MuJoCo model.

The frame of the scene has its origin on the table top, x away from the robot, z up. Names of a robot's elements get the
robot's name as prefix (`fr3/joint1`, `fr3/gripper/tcp`), those of a camera the camera's (`wrist/...`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from rcs._core import Trajectory
from rcs.errors import InvalidSetup
from rcs.kinematics.chain import GRIPPER_PREFIX, attach_end_effector, compiled, load, mount_frame
from rcs.robots.camera import Calibration, CameraDescription
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription, Mount
from rcs.robots.mount import Obstacle
from rcs.sim.detail import Assets, exchange_visuals
from rcs.sim.model_fields import FieldRange, prepare_model
from rcs.sim.robot_model import add_load, check_robot, give_way
from rcs.sim.tactile_mounts import TactilePlacement, attach_tactile
from rcs.sim.textures import add_wood

OVERVIEW = "overview"
"""Name of the camera that shows the whole scene to people; it is not observed."""
OVERVIEW_EYE, OVERVIEW_TARGET = [1.45, -1.05, 0.85], [0.28, 0.02, 0.22]
"""Position of the overview camera of an empty scene, and its target [m]; with robots, it looks the same way."""
OVERVIEW_MIDDLE = (0.35, 0.0, 0.5)
"""Point in the middle of the overview, from the base of a robot, in parts of its reach."""
OVERVIEW_DISTANCE = 2.05
"""Distance of the overview from it, in parts of the reach: for two arms it stays within the walls."""

TABLE = "table"
"""Name of the body of the table."""
TABLE_THICKNESS = 0.04
STEEPEST = -0.7
"""Steepest downward view of a camera on a stand (z of its direction)."""
FLOOR_HEIGHT = -0.76
"""A common table height [m], below the table top."""


@dataclass(frozen=True, kw_only=True)
class RobotPlacement:
    """One robot and its place."""

    name: str
    """Name in keys and prefixes, such as `fr3`."""
    arm: ArmDescription
    gripper: GripperDescription | None = None
    hand: HandDescription | None = None
    """The hand, instead of a gripper."""
    base_in_scene: Mount = Mount()
    """Pose of the robot's base frame in the scene."""
    compliance: Compliance | None = None
    """How the arm gives way to a push; None for stiff servos."""

    def __post_init__(self) -> None:
        """Check that there is one end effector at most.

        Raises:
            InvalidSetup: There are both a gripper and a hand.
        """
        if self.gripper is not None and self.hand is not None:
            raise InvalidSetup(f"Robot {self.name!r} has a gripper and a hand; a flange carries only one.")

    @property
    def end_effector(self) -> GripperDescription | HandDescription | None:
        """The end effector."""
        return self.gripper or self.hand

    @property
    def prefix(self) -> str:
        """Prefix of the arm's element names."""
        return f"{self.name}/"

    @property
    def motion(self) -> str:
        """Name of the model's number with the place of the arm's motion in the user data."""
        return f"{self.prefix}motion"

    @property
    def gripper_prefix(self) -> str:
        """Prefix of the end effector's element names."""
        return self.prefix + GRIPPER_PREFIX

    @property
    def base_body(self) -> str:
        """Name of the base body in the scene."""
        return self.prefix + self.arm.base_body

    @property
    def tcp_site(self) -> str:
        """Name of the TCP site in the scene; the flange without a gripper."""
        if self.end_effector is None:
            return self.prefix + self.arm.flange_site
        return self.gripper_prefix + self.end_effector.tcp_site


@dataclass(frozen=True, kw_only=True)
class CameraPlacement:
    """One camera and where it is mounted."""

    name: str
    """Name in keys and prefixes, such as `wrist`."""
    camera: CameraDescription
    parent_body: str
    """Body of the scene that carries it; `world` if it is fixed."""
    optical_in_parent: Mount
    """Pose of the optical frame (x right, y down, z forward) in the parent body's frame."""
    calibration: Calibration | None = None
    """How it sees as calibrated; None for as in the data sheet."""

    @property
    def fovy(self) -> float:
        """Vertical field of view of the whole calibrated picture, or of the data sheet's [rad]."""
        intrinsics = None if self.calibration is None else self.calibration.intrinsics
        return self.camera.fovy if intrinsics is None else 2.0 * np.arctan(0.5 * intrinsics.height / intrinsics.fy)

    @property
    def camera_name(self) -> str:
        """Name of the camera element in the scene."""
        return f"{self.name}/{self.camera.camera}"


@dataclass
class Scene:
    """A scene under construction. `spec` is MuJoCo's own and may be changed freely before `compile`."""

    spec: mujoco.MjSpec
    robots: list[RobotPlacement] = field(default_factory=list)
    cameras: list[CameraPlacement] = field(default_factory=list)
    has_textures: bool = False
    tactile: list[TactilePlacement] = field(default_factory=list)
    varied: Sequence[FieldRange] = ()
    """Fields of the model that will vary from episode to episode."""
    _lacks_details: bool = field(default=False, init=False, repr=False)
    """Detailed visuals are unavailable; the next robot neither waits for the network nor warns again."""

    @staticmethod
    def empty(*, physics_step: float = 0.002, has_textures: bool = False) -> Scene:
        """Start a scene with a floor, lights and solver settings for grasping.

        Args:
            physics_step: Time step of the physics [s].
            has_textures: Whether furniture has textures, which take a tenth of a small frame's time.
        """
        spec = mujoco.MjSpec()
        spec.modelname = "rcs"
        option = spec.option
        option.timestep = physics_step
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        # A soft contact creeps at a rate of about 1 / impratio, and high ratios need elliptic cones: 7 um/s at 100,
        # where MuJoCo's defaults let a grasped object slide by 1.4 mm/s (MuJoCo documentation, "Preventing slip";
        # measured).
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = 20.0
        option.tolerance = 1e-10
        spec.visual.global_.offwidth = 1280
        spec.visual.global_.offheight = 720
        spec.visual.map.znear = 0.005
        spec.visual.map.zfar = 20.0
        spec.visual.headlight.ambient = [0.36, 0.36, 0.36]
        spec.visual.headlight.diffuse = [0.12, 0.12, 0.12]
        spec.visual.headlight.specular = [0.0, 0.0, 0.0]
        # Fixed, so that pictures do not depend on the rest of the scene.
        spec.stat.extent = 1.5
        spec.stat.center = [0.4, 0.0, 0.3]
        scene = Scene(spec, has_textures=has_textures)
        scene._add_room()
        scene._add_lights()
        spec.worldbody.add_camera(
            name=OVERVIEW, pos=OVERVIEW_EYE, xyaxes=_axes_looking(OVERVIEW_EYE, OVERVIEW_TARGET), fovy=42
        )
        return scene

    def _add_room(self) -> None:
        """Add a floor and three walls: boxes are almost free to draw, and no lab has a black background."""
        room: dict[str, tuple[list[float], list[float], list[float]]] = {
            "floor": ([0.3, 0.0, FLOOR_HEIGHT - 0.05], [2.5, 2.5, 0.05], [0.42, 0.44, 0.47, 1.0]),
            "back wall": ([-1.25, 0.0, 0.8], [0.05, 2.5, 1.6], [0.80, 0.81, 0.82, 1.0]),
            "right wall": ([0.3, -1.75, 0.8], [2.5, 0.05, 1.6], [0.76, 0.78, 0.80, 1.0]),
            "left wall": ([0.3, 1.75, 0.8], [2.5, 0.05, 1.6], [0.76, 0.78, 0.80, 1.0]),
        }
        for name, (pos, size, rgba) in room.items():
            self.spec.worldbody.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=pos,
                size=size,
                rgba=rgba,
                # Only falling objects touch the floor, and nothing touches the walls.
                contype=int(name == "floor"),
                conaffinity=int(name == "floor"),
                group=0,
            )

    def _add_lights(self) -> None:
        for x in (-0.6, 1.4):
            for y in (-1.0, 1.0):
                self.spec.worldbody.add_light(
                    name=f"light {'back' if x < 0 else 'front'} {'right' if y < 0 else 'left'}",
                    type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
                    pos=[x, y, 2.2],
                    dir=[0.4 - x, -y, -2.2],
                    diffuse=[0.17, 0.17, 0.17],
                    specular=[0.05, 0.05, 0.05],
                    # Only one light casts shadows: four shadow maps cost four times as much and add little.
                    castshadow=x < 0 and y < 0,
                )

    def _aim_overview(self, robots: list[RobotPlacement]) -> None:
        """Move the overview camera back until it sees whole robots, however high they reach."""
        camera = self.spec.camera(OVERVIEW)
        if camera is None:
            return  # a scene of the user's own
        bases = np.array([robot.base_in_scene.translation for robot in robots])
        reach = max(robot.arm.workspace_reach for robot in robots)
        target = bases.mean(axis=0) + np.array(OVERVIEW_MIDDLE) * reach
        distance = OVERVIEW_DISTANCE * reach + np.ptp(bases, axis=0).max() / 2
        away = np.subtract(OVERVIEW_EYE, OVERVIEW_TARGET)
        camera.pos = target + distance * away / np.linalg.norm(away)

    def add_table(self) -> None:
        """Add a table whose top is the plane z = 0."""
        body = self.spec.worldbody.add_body(name=TABLE, pos=[0.35, 0.0, 0.0])
        top = [0.60, 0.65, TABLE_THICKNESS / 2]
        body.add_geom(
            name="table top",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=top,
            pos=[0.0, 0.0, -TABLE_THICKNESS / 2],
            rgba=[0.70, 0.56, 0.40, 1.0],
            # Less than an object's, so that the object's counts: MuJoCo takes the greater of two.
            friction=[0.5, 0.005, 0.0001],
            solref=[0.004, 2.0],
            group=0,
        )
        if self.has_textures:
            self.spec.geom("table top").material = add_wood(self.spec)
        leg = -FLOOR_HEIGHT - TABLE_THICKNESS
        for x in (-1, 1):
            for y in (-1, 1):
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    size=[0.03, 0.03, leg / 2],
                    pos=[x * (top[0] - 0.05), y * (top[1] - 0.05), -TABLE_THICKNESS - leg / 2],
                    rgba=[0.30, 0.30, 0.32, 1.0],
                    contype=0,
                    conaffinity=0,
                    group=1,
                )

    def add_obstacle(self, name: str, obstacle: Obstacle) -> None:
        """Add a box that stands still.

        Args:
            name: Name of its body and geom.
            obstacle: Its size, place and colour.
        """
        body = self.spec.worldbody.add_body(name=name, pos=obstacle.pose.translation)
        x, y, z, w = obstacle.pose.quaternion
        body.quat = [w, x, y, z]
        half = [edge / 2 for edge in obstacle.size]
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=[*obstacle.colour, 1.0], condim=4, group=0
        )

    def add_robot(self, robot: RobotPlacement, *, assets: Assets = "builtin") -> None:
        """Add a robot to the scene, with its end effector.

        Args:
            robot: The robot and its place.
            assets: Source of its looks; nothing else depends on it.

        Raises:
            InvalidSetup: The scene already has a robot of that name, or the compliance is not one of the arm.
        """
        if any(other.name == robot.name for other in self.robots):
            raise InvalidSetup(f"Two robots are named {robot.name!r}; give each a name of its own.")
        arm = load(robot.arm)
        if robot.end_effector is not None:
            attach_end_effector(arm, robot.arm, robot.end_effector)
        if assets == "menagerie" and not self._lacks_details:
            parts = [("", robot.arm.menagerie)]
            if robot.gripper is not None:
                parts.append((GRIPPER_PREFIX, robot.gripper.menagerie))
            self._lacks_details = not exchange_visuals(arm, parts)
        add_load(arm, robot.arm)
        give_way(arm, robot)
        self.spec.attach(arm, frame=mount_frame(self.spec.worldbody, robot.base_in_scene), prefix=robot.prefix)
        self._aim_overview([*self.robots, robot])
        for actuator in robot.arm.actuators:
            # The control of a moving servo leads its target, even where that is a limit; the motion keeps the limits.
            self.spec.actuator(robot.prefix + actuator).ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        self.spec.add_numeric(name=robot.motion, data=[self.spec.nuserdata])
        self.spec.nuserdata += Trajectory.size(robot.arm.dof)
        self.robots.append(robot)

    def add_camera(self, camera: CameraPlacement) -> None:
        """Mount a camera on a body of the scene.

        Raises:
            InvalidSetup: The name is taken, or the body is not in the scene.
        """
        if any(other.name == camera.name for other in self.cameras):
            raise InvalidSetup(f"Two cameras are named {camera.name!r}; give each a name of its own.")
        parent = self.spec.body(camera.parent_body)
        if parent is None:
            raise InvalidSetup(
                f"Camera {camera.name!r} is mounted on {camera.parent_body!r}, which is not in the scene."
            )
        frame = mount_frame(parent, camera.optical_in_parent)
        housing = load(camera.camera)
        has_housing = bool(housing.geoms)
        self.spec.attach(housing, frame=frame, prefix=f"{camera.name}/")
        eye = self.spec.camera(camera.camera_name)
        if not np.isclose(eye.fovy, np.degrees(camera.fovy), rtol=1e-12):  # other than that of the model file
            eye.fovy = np.degrees(camera.fovy)
        self.cameras.append(camera)
        if not has_housing:
            return  # nothing visible would float
        if camera.parent_body in {"world", *(robot.base_body for robot in self.robots)}:
            self._add_stand(parent, camera)
        else:
            self._add_bracket(parent, camera)

    def _add_bracket(self, parent: mujoco.MjsBody, camera: CameraPlacement) -> None:
        """Draw a bracket between a moving camera and its body, so that it does not seem to float."""
        optical = camera.optical_in_parent
        behind = np.array(optical.translation) - 0.012 * optical.pose.matrix[:3, 2]
        if np.allclose(behind[:2], 0.0):
            return  # on the z axis of the body, a bracket would have no length
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[0.006, 0.0, 0.0],
            fromto=[0.0, 0.0, behind[2], *behind],
            group=2,
            **_VISUAL,
        )

    def add_tactile(self, sensor: TactilePlacement) -> None:
        """Mount a tactile sensor on a body of the scene, such as a finger instead of its pad.

        Raises:
            InvalidSetup: The name is taken, or the body or the pad is not in the scene.
        """
        if any(other.name == sensor.name for other in [*self.tactile, *self.cameras]):
            raise InvalidSetup(f"Two sensors are named {sensor.name!r}; give each a name of its own.")
        attach_tactile(self.spec, sensor)
        self.tactile.append(sensor)

    def _add_stand(self, parent: mujoco.MjsBody, camera: CameraPlacement) -> None:
        """Add a post, without collisions, under a fixed camera."""
        x, y, z = camera.optical_in_parent.translation
        forward = camera.optical_in_parent.pose.matrix[:3, 2]
        if forward[2] < STEEPEST:
            return  # it looks down, and would see its own post
        # Behind the optical centre, so that the camera does not see its own post.
        back = -0.02 * forward
        top = z - 0.02
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.012, 0.012, (top - FLOOR_HEIGHT) / 2],
            pos=[x + back[0], y + back[1], (top + FLOOR_HEIGHT) / 2],
            group=1,
            **_VISUAL,
        )

    def compile(self) -> mujoco.MjModel:
        """Compile the model; warn about robots whose servos cannot carry their weight.

        Raises:
            InvalidSetup: A part cannot be compiled, a base is moved by a pose in its file, or a varied field is wrong.
        """
        arms = [robot.arm for robot in self.robots]
        effectors = [robot.end_effector for robot in self.robots if robot.end_effector is not None]
        model = compiled(self.spec, [*arms, *effectors, *(camera.camera for camera in self.cameras)])
        for robot in self.robots:
            check_robot(robot, model)
        prepare_model(model, self.varied)
        return model


_VISUAL = {"rgba": [0.20, 0.20, 0.22, 1.0], "contype": 0, "conaffinity": 0, "mass": 0.0}  # nothing touches it


def _axes_looking(eye: list[float], target: list[float]) -> list[float]:
    """Return x and y axes of an upright MuJoCo camera (looking along -z) at `eye` that looks at `target`."""
    back = np.subtract(eye, target)
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    return [*right, *np.cross(back, right)]
