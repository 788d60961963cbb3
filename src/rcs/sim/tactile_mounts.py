"""Mounts of tactile sensors: where they are, how they replace a finger's pad, and where a robot's pads are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics.chain import load, mount_frame
from rcs.robots.description import GripperDescription, Mount
from rcs.robots.tactile import TactileDescription
from rcs.spatial import Pose

if TYPE_CHECKING:  # a scene mounts sensors
    from rcs.sim.scene import RobotPlacement

Vector = NDArray[np.float64]

FAR = 1.0
"""A distance greater than any gripper's width [m]."""
CONTACT_FIELDS = ("condim", "friction", "solref", "solimp", "margin", "gap", "priority", "solmix")
"""Attributes that a gel takes over from the pad that it replaces: contact properties, not shape."""
UNFELT_GROUP = 5
"""Group of geoms that are neither visible nor felt."""


@dataclass(frozen=True, kw_only=True)
class TactilePlacement:
    """One tactile sensor and its mount."""

    name: str
    """Name in keys and prefixes, such as `left_touch`."""
    sensor: TactileDescription
    parent_body: str
    """Body of the scene that carries it; `world` if it is fixed."""
    sensor_in_parent: Mount
    """Pose of the sensor's frame (x out of the gel, z along its longer side) in the parent body's frame."""
    replaced_pad: str | None = None
    """Geom of the parent body that the gel replaces; None if nothing is in its way.

    The gel gets its name, so that queries for the pad's contacts find the gel, and its friction and stiffness, so that
    grasps hold as well. Other geoms of the finger in the gel's way are removed.
    """
    other_pads: tuple[str, ...] = ()
    """Other pads of the same finger: they keep their names but no longer collide."""

    @property
    def body_name(self) -> str:
        """Name of the sensor's body in the scene."""
        return f"{self.name}/{self.sensor.base_body}"

    @property
    def gel_name(self) -> str:
        """Name of the gel's geom in the scene."""
        return self.replaced_pad or f"{self.name}/{self.sensor.gel_geom}"


def attach_tactile(spec: mujoco.MjSpec, placement: TactilePlacement) -> None:
    """Mount a tactile sensor on a body of a scene.

    Args:
        spec: The scene, changed in place.
        placement: The sensor and its mount.

    Raises:
        InvalidSetup: The body or one of the other pads is not in the scene, or the body lacks the pad.
    """
    parent = spec.body(placement.parent_body)
    if parent is None:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} is mounted on {placement.parent_body!r}, which is not in the scene."
        )
    pad = None if placement.replaced_pad is None else _pad(parent, placement)
    if missing := [name for name in placement.other_pads if spec.geom(name) is None]:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} has other pads that are not in the scene: {missing}; "
            f"{placement.parent_body!r} has {_geom_names(parent)}."
        )
    frame = mount_frame(parent, placement.sensor_in_parent)
    spec.attach(load(placement.sensor), frame=frame, prefix=f"{placement.name}/")
    if pad is not None:
        gel = spec.geom(f"{placement.name}/{placement.sensor.gel_geom}")
        for field in CONTACT_FIELDS:
            setattr(gel, field, getattr(pad, field))
        _clear_way(spec, parent, pad, placement)
        spec.delete(pad)
        gel.name = placement.replaced_pad
    for name in placement.other_pads:
        _retire(spec.geom(name))
    # The sensor is part of the finger, so it shares the finger's contact exclusions.
    for exclude in list(spec.excludes):
        pair = [exclude.bodyname1, exclude.bodyname2]
        if placement.parent_body in pair:
            pair.remove(placement.parent_body)
            spec.add_exclude(bodyname1=placement.body_name, bodyname2=pair[0])


def _pad(parent: mujoco.MjsBody, placement: TactilePlacement) -> mujoco.MjsGeom:
    """Return the pad that the sensor replaces."""
    pads = [geom for geom in parent.geoms if geom.name == placement.replaced_pad]
    if not pads:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} cannot replace {placement.replaced_pad!r}; {placement.parent_body!r} "
            f"has {_geom_names(parent)}."
        )
    return pads[0]


def _geom_names(body: mujoco.MjsBody) -> list[str]:
    return [geom.name for geom in body.geoms if geom.name]


def _clear_way(spec: mujoco.MjSpec, parent: mujoco.MjsBody, pad: mujoco.MjsGeom, placement: TactilePlacement) -> None:
    """Remove visuals inside of a pad, and geoms of its finger inside of the sensor that reach into the gel.

    Geoms centred elsewhere carry the sensor and stay. Named geoms stay for lookups, but no longer collide.
    """
    model = spec.copy().compile()  # compiled, since a file may give geoms by their ends or by angles
    sensor, mount = placement.sensor, placement.sensor_in_parent
    in_sensor = Pose(mount.translation, mount.quaternion).inverse()
    depth = sensor.gel_center[0] - sensor.camera_position[0]
    # A box that the housing and the gel fill, with half of its edges.
    middle = np.array(sensor.gel_center) - [0.5 * depth, 0.0, 0.0]
    edges = 0.5 * np.array([depth, sensor.gel_width, sensor.gel_height])
    pad_index = model.geom(pad.name).id
    in_pad = _pose_of(model, pad_index).inverse()
    first = int(model.body(parent.name).geomadr[0])
    for index, geom in enumerate(list(parent.geoms), first):
        if geom.name == pad.name or geom.name in placement.other_pads:
            continue
        box, pose = model.geom_aabb[index], _pose_of(model, index)
        place = pose * Pose(box[:3])
        is_pad = (np.abs((in_pad * place).translation) < model.geom_aabb[pad_index, 3:]).all()
        is_inside = (np.abs((in_sensor * place).translation - middle) < edges).all()
        front = (in_sensor * place).translation[0] + np.abs((in_sensor * pose).matrix[0, :3]) @ box[3:]
        if not is_pad and not (is_inside and front > sensor.gel_center[0] - sensor.gel_bulge):
            continue
        if geom.name:
            _retire(geom)
        else:
            spec.delete(geom)


def _pose_of(model: mujoco.MjModel, geom: int) -> Pose:
    """Return the pose of a geom in its body."""
    return Pose(model.geom_pos[geom], np.roll(model.geom_quat[geom], -1))


def _retire(geom: mujoco.MjsGeom) -> None:
    """Make a geom invisible, without contacts, and not felt."""
    geom.contype = geom.conaffinity = 0
    geom.group = UNFELT_GROUP


def on_pads(robot: RobotPlacement, sensor: TactileDescription) -> tuple[TactilePlacement, TactilePlacement]:
    """Return sensors instead of the left and right pad of a gripper.

    Each gel protrudes most in the middle of its pad's face, so grasped objects and the meaning of the opening stay the
    same. The face is found in the model, for any gripper whose description names its pads.

    Args:
        robot: A robot with a gripper; the sensors are named `<robot>_left` and `<robot>_right`.
        sensor: The sensor.

    Raises:
        InvalidSetup: The robot has no gripper, or its pads do not face each other along the y axis of its TCP.
    """
    gripper = robot.gripper
    if gripper is None:
        given = "nothing at its flange" if robot.end_effector is None else f"a hand, {robot.end_effector.label}"
        raise InvalidSetup(f"Robot {robot.name!r} has {given}; {sensor.label} is mounted on the pads of a gripper.")
    hand = _Closed(gripper)
    across, along = hand.tcp_rotation[:, 1], hand.tcp_rotation[:, 2]
    left_pads, right_pads = gripper.pad_geoms
    if (hand.middle(left_pads) - hand.middle(right_pads)) @ across <= 0.0:
        raise InvalidSetup(
            f"{gripper.name}: the y axis of the TCP must point from the pads of the right finger, {right_pads}, "
            f"to those of the left, {left_pads}."
        )
    left = hand.mount(robot, "left", left_pads, across, along, sensor)
    right = hand.mount(robot, "right", right_pads, -across, along, sensor)
    return left, right


class _Closed:
    """A gripper alone, closed."""

    def __init__(self, gripper: GripperDescription) -> None:
        self._description = gripper
        self._model = load(gripper).compile()
        self._data = mujoco.MjData(self._model)
        for name, position in zip(gripper.joints, gripper.joint_closed, strict=True):
            self._data.qpos[self._model.joint(name).qposadr[0]] = position
        mujoco.mj_kinematics(self._model, self._data)
        self.tcp_rotation: Vector = self._data.site(gripper.tcp_site).xmat.reshape(3, 3).copy()

    def middle(self, geoms: Sequence[str]) -> Vector:
        """Return the mean position of geoms [m]."""
        return np.mean([self._data.geom(name).xpos for name in geoms], axis=0)

    def mount(
        self,
        robot: RobotPlacement,
        side: str,
        pads: Sequence[str],
        inwards: Vector,
        along: Vector,
        sensor: TactileDescription,
    ) -> TactilePlacement:
        """Return a sensor on the face of pads, in their middle and facing against a direction.

        Args:
            robot: The robot.
            side: Suffix of the sensor's name, after the robot.
            pads: Geoms of one finger.
            inwards: Direction into the pads.
            along: Direction of the finger.
            sensor: The sensor.
        """
        groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        groups[0] = 1
        self._model.geom_group[:] = 1
        for name in pads:
            self._model.geom_group[self._model.geom(name).id] = 0
        direction = inwards / np.linalg.norm(inwards)
        start = self.middle(pads) - FAR * direction
        geom, normal = np.empty(1, np.int32), np.empty(3)
        distance = mujoco.mj_ray(self._model, self._data, start, direction, groups, 1, -1, geom, normal)
        if distance < 0.0:
            raise InvalidSetup(
                f"{self._description.name}: found no surface on {tuple(pads)} for {sensor.label};  "
                "place it yourself with TactilePlacement."
            )
        body = int(self._model.geom_bodyid[geom[0]])
        replaced = self._model.geom(int(geom[0])).name
        touch = _facing(normal, along, start + distance * direction)
        to_body = Pose(self._data.xpos[body], np.roll(self._data.xquat[body], -1)).inverse()
        touch_in_finger = to_body * touch
        # Its gel protrudes most where the pad is touched.
        x, y, z = (touch_in_finger * Pose([-value for value in sensor.gel_center])).translation.tolist()
        a, b, c, w = touch_in_finger.quaternion.tolist()
        return TactilePlacement(
            name=f"{robot.name}_{side}",
            sensor=sensor,
            parent_body=robot.gripper_prefix + self._model.body(body).name,
            sensor_in_parent=Mount(translation=(x, y, z), quaternion=(a, b, c, w)),
            replaced_pad=robot.gripper_prefix + replaced,
            other_pads=tuple(robot.gripper_prefix + name for name in pads if name != replaced),
        )


def _facing(normal: Vector, along: Vector, place: Vector) -> Pose:
    """Return a pose with x along a normal and z as near as possible to a direction."""
    z = along - (along @ normal) * normal
    z /= np.linalg.norm(z)
    matrix = np.eye(4)
    matrix[:3] = np.stack([normal, np.cross(z, normal), z, place], axis=1)
    return Pose.from_matrix(matrix)
