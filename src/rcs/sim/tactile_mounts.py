"""Where tactile sensors go on grippers: in the place of the pads."""

from __future__ import annotations

import math

from rcs.errors import InvalidSetup
from rcs.robots.description import Mount
from rcs.robots.tactile import TactileDescription
from rcs.sim.scene import RobotPlacement
from rcs.sim.tactile_placement import TactilePlacement
from rcs.spatial import Pose


def on_pad(touch_in_finger: Mount, sensor: TactileDescription) -> Mount:
    """Return the pose of a sensor whose gel protrudes most at a given point of a finger.

    Args:
        touch_in_finger: The point where the pad touches and how it faces, in the finger's frame: x out of the pad, z
            towards the fingertip.
        sensor: The sensor.

    Returns:
        Pose of the sensor's frame in the finger's frame.
    """
    back = Pose([-value for value in sensor.gel_center])
    pose = Pose(touch_in_finger.translation, touch_in_finger.quaternion) * back
    x, y, z = pose.translation.tolist()
    return Mount(translation=(x, y, z), quaternion=touch_in_finger.quaternion)


def franka_hand_pads(robot: RobotPlacement, sensor: TactileDescription) -> tuple[TactilePlacement, TactilePlacement]:
    """Return sensors in the place of the left and the right pad of a Franka Hand.

    The gels meet where the pads met, with their middle at the TCP: what is grasped is where it was, and the hand's
    opening means what it meant.

    Args:
        robot: A robot with a Franka Hand; the sensors are named `<robot>_left` and `<robot>_right`.
        sensor: The sensor.

    Raises:
        InvalidSetup: The robot has another gripper, or none.
    """
    if robot.gripper is None or robot.gripper.name != "franka_hand":
        given = None if robot.gripper is None else robot.gripper.name
        raise InvalidSetup(f"Robot {robot.name!r} has the gripper {given!r}; these mounts are for 'franka_hand'.")
    # The pads meet in the plane y = 0 of the finger's frame, with the finger on the side of +y. The fingers start
    # 0.0584 m in front of the hand (franka_description 1.0.1).
    touch = Mount(
        translation=(0.0, 0.0, robot.gripper.tcp_in_base.translation[2] - 0.0584),
        quaternion=(0.0, 0.0, -math.sqrt(0.5), math.sqrt(0.5)),
    )
    (left_pad,), (right_pad,) = robot.gripper.pad_geoms
    left, right = (
        TactilePlacement(
            name=f"{robot.name}_{side}",
            sensor=sensor,
            parent_body=f"{robot.gripper_prefix}{side}_finger",
            sensor_in_parent=on_pad(touch, sensor),
            replaced_pad=robot.gripper_prefix + pad,
        )
        for side, pad in (("left", left_pad), ("right", right_pad))
    )
    return left, right
