"""The figures of the SO101 follower arm."""

from __future__ import annotations

from math import pi
from typing import Final

from rcs.robots.description import ArmDescription, CollisionLimits, MenagerieVisuals

SO101: Final = ArmDescription(
    name="so101",
    label="SO101",
    module=__name__,
    mjcf_file="so101.xml",
    base_body="base",
    joints=("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
    actuators=("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
    # In the axis of the wrist roll, z towards the gripper.
    flange_site="flange",
    # Our choice: the gripper is 15 cm above the middle of its workspace, pointing down and 30 degrees ahead.
    home=(0.0, -pi / 6, pi / 18, 4 * pi / 9, 0.0),
    # mujoco_menagerie robotstudio_so101: 0 is the middle of the range ("new" calibration of SO-ARM100).
    joint_lower=(-1.91986, -1.7453293, -1.69, -1.658063, -2.7438473),
    joint_upper=(1.91986, 1.7453293, 1.69, 1.658063, 2.7438473),
    # Servo's data sheet, STS3215 at 12 V: 30 kg cm stall torque, 45 rpm (4.7 rad/s) without load. No torque is left at
    # that speed. Ours: 60 % of it, and the acceleration that the torque then left gives the arm stretched out.
    velocity_limit=(2.8,) * 5,
    effort_limit=(2.94,) * 5,
    acceleration_limit=(15.0,) * 5,
    # Not published. Ours: full acceleration after 5 ms.
    jerk_limit=(3000.0,) * 5,
    # Feetech's table of registers, factory values: a servo that exerts over 80 % (36) of its stall torque for 2 s (35)
    # goes into its overload protection.
    collision=CollisionLimits(joint_torque=(0.8 * 2.94,) * 5, loads="drive", duration=2.0),
    # Ours: of uniformly random relative poses near home, one in five asks for more than the joints can do.
    tcp_speed=0.25,
    tcp_turn_speed=1.0,
    # Reach from the shoulder lift to the flange with the arm stretched out: 0.116 + 0.135 + 0.061 m.
    workspace_reach=0.312,
    # Its wrist ends in a servo horn made for its own gripper, and lifts a few hundred grams.
    end_effectors=("so101_gripper",),
    sources=(
        "mujoco_menagerie robotstudio_so101 (Apache-2.0): kinematics, limits, inertias, joint dynamics",
        "TheRobotStudio SO-ARM100 (Apache-2.0): the published description that the former follows",
        "Feetech STS3215 data sheet: speed, torque; table of registers: overload protection",
    ),
    menagerie=MenagerieVisuals.of(
        "robotstudio_so101",
        "so101",
        {name: name for name in ("base", "shoulder", "upper_arm", "lower_arm", "wrist")},
    ),
)
"""The SO101 arm with five joints."""
