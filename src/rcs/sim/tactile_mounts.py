"""Mounts of tactile sensors on grippers and hands: instead of the pads, found in the robot's model."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics.chain import EndEffector, load
from rcs.robots.description import Mount
from rcs.robots.tactile import TactileDescription
from rcs.sim.scene import RobotPlacement
from rcs.sim.tactile_placement import TactilePlacement
from rcs.spatial import Pose

Vector = NDArray[np.float64]

FAR = 1.0
"""A distance greater than any gripper's width [m]."""


def on_pad(touch_in_finger: Mount, sensor: TactileDescription) -> Mount:
    """Return the pose of a sensor whose gel protrudes most at a given point of a finger.

    Args:
        touch_in_finger: Contact point and orientation of the pad in the finger's frame: x out of the pad, z towards the
            fingertip.
        sensor: The sensor.

    Returns:
        Pose of the sensor's frame in the finger's frame.
    """
    back = Pose([-value for value in sensor.gel_center])
    pose = Pose(touch_in_finger.translation, touch_in_finger.quaternion) * back
    x, y, z = pose.translation.tolist()
    return Mount(translation=(x, y, z), quaternion=touch_in_finger.quaternion)


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
    hand = _Posed(gripper)
    hand.put(gripper.joints, gripper.joint_closed)
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


def on_fingertips(
    robot: RobotPlacement, sensor: TactileDescription, fingers: Sequence[str]
) -> tuple[TactilePlacement, ...]:
    """Return sensors instead of fingertips of a hand, facing the direction in which they bend towards the TCP.

    Args:
        robot: A robot with a hand; the sensors are named `<robot>_<finger>`.
        sensor: The sensor.
        fingers: Names of the fingers, such as `thumb`; the last of a finger's geoms is its tip.

    Raises:
        InvalidSetup: The robot has no hand, or the hand no such finger.
    """
    if robot.hand is None:
        raise InvalidSetup(f"Robot {robot.name!r} has no hand; on the pads of a gripper, use on_pads.")
    unknown = [finger for finger in fingers if finger not in robot.hand.finger_geoms]
    if unknown or not fingers:
        raise InvalidSetup(
            f"fingers is {tuple(fingers)}; {robot.hand.label} has {', '.join(robot.hand.finger_geoms)}; "
            "name at least one."
        )
    hand = _Posed(robot.hand)
    lower, upper = np.array(robot.hand.joint_lower), np.array(robot.hand.joint_upper)
    hand.put(robot.hand.joints, lower + np.array(robot.hand.open_pose) * (upper - lower))
    mounts: list[TactilePlacement] = []
    for finger in fingers:
        tip = robot.hand.finger_geoms[finger][-1]
        joint, axis = hand.hinge(tip)
        middle = hand.middle([tip])
        along = middle - joint
        along -= (along @ axis) * axis
        bend = np.cross(axis, along)
        inwards = bend * np.sign(bend @ (middle - hand.tcp_position))
        mounts.append(hand.mount(robot, finger, [tip], inwards, along, sensor))
    return tuple(mounts)


class _Posed:
    """A gripper or hand alone, in a pose."""

    def __init__(self, description: EndEffector) -> None:
        self._description = description
        self._model = load(description).compile()
        self._data = mujoco.MjData(self._model)

    def put(self, joints: Sequence[str], positions: Sequence[float] | Vector) -> None:
        """Put joints at positions [rad or m]."""
        for name, position in zip(joints, positions, strict=True):
            self._data.qpos[self._model.joint(name).qposadr[0]] = position
        mujoco.mj_kinematics(self._model, self._data)

    @property
    def tcp_position(self) -> Vector:
        return self._data.site(self._description.tcp_site).xpos.copy()

    @property
    def tcp_rotation(self) -> Vector:
        return self._data.site(self._description.tcp_site).xmat.reshape(3, 3).copy()

    def middle(self, geoms: Sequence[str]) -> Vector:
        """Return the mean position of geoms [m]."""
        return np.mean([self._data.geom(name).xpos for name in geoms], axis=0)

    def hinge(self, geom: str) -> tuple[Vector, Vector]:
        """Return position [m] and axis of the joint that moves a geom."""
        weld = self._model.body_weldid[self._model.geom(geom).bodyid[0]]
        joint = self._model.body_jntadr[weld]
        return self._data.xanchor[joint].copy(), self._data.xaxis[joint].copy()

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
        x, y, z = touch_in_finger.translation.tolist()
        a, b, c, w = touch_in_finger.quaternion.tolist()
        return TactilePlacement(
            name=f"{robot.name}_{side}",
            sensor=sensor,
            parent_body=robot.gripper_prefix + self._model.body(body).name,
            sensor_in_parent=on_pad(Mount(translation=(x, y, z), quaternion=(a, b, c, w)), sensor),
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
