"""The figures of the SO101 follower arm and of its gripper."""

from __future__ import annotations

from math import pi, sqrt
from typing import Final

from rcs.robots.description import ArmDescription, CollisionLimits, GripperDescription, MenagerieVisuals, Mount

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
        "robotstudio_so101", "so101", {name: name for name in ("base", "shoulder", "upper_arm", "lower_arm", "wrist")}
    ),
)
"""The SO101 arm with five joints."""

_HALF = sqrt(0.5)

SO101_GRIPPER: Final = GripperDescription(
    name="so101_gripper",
    label="SO101 gripper",
    module=__name__,
    mjcf_file="so101_gripper.xml",
    # The published gripper link: its jaws point along -z and open along x.
    base_body="gripper",
    # It is screwed to the servo horn of the arm's last joint, not to a flange.
    arms=("so101",),
    # A half turn about x, from the flange's z to the link's -z.
    mount_in_flange=Mount(quaternion=(1.0, 0.0, 0.0, 0.0)),
    tcp_site="tcp",
    # Origin of the published `gripperframe`, 2 cm before the fixed jaw at the fingertips; that frame itself is a site
    # too. Here z points along the jaws and y from the fixed to the moving one, as with the other grippers.
    tcp_in_base=Mount(translation=(0.012, -0.000218, -0.098127), quaternion=(_HALF, _HALF, 0.0, 0.0)),
    joints=("gripper",),
    # mujoco_menagerie robotstudio_so101: the range of the jaw, -10 to 100 degrees.
    joint_closed=(-0.174533,),
    joint_open=(1.7453292,),
    actuator="gripper",
    # The jaw's angle [rad].
    ctrl_closed=-0.174533,
    ctrl_open=1.7453292,
    # Left is at the TCP's +y, as with the other grippers.
    pad_geoms=(("moving_pad",), ("fixed_pad",)),
    # Between the middles of both pads when open.
    max_width=0.117,
    # LeRobot limits this servo to half of its torque, 1.47 Nm: 18 N at the fingertips.
    max_force=18.0,
    grasp_force=18.0,
    # The speed of the moving jaw's tip: torque less friction over damping is 2.4 rad/s, 0.85 s from open to closed. At
    # its full torque and without load the servo has 45 rpm, 4.7 rad/s.
    closing_speed=0.18,
    sources=(
        "mujoco_menagerie robotstudio_so101 (Apache-2.0): kinematics, limits, inertias, joint dynamics, servo gains",
        "Feetech STS3215 data sheet, 12 V: speed without load 45 rpm",
        "LeRobot so101_follower (Apache-2.0): torque limit of the gripper's servo",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness of the pads",
    ),
    menagerie=MenagerieVisuals.of(
        "robotstudio_so101", "so101", {"gripper": "gripper", "moving_jaw": "moving_jaw_so101_v1"}
    ),
)
"""The SO101 gripper with one moving jaw."""
