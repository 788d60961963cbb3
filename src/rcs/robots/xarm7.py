"""The figures of the UFACTORY xArm 7."""

from __future__ import annotations

from typing import Final

from rcs.robots.description import ArmDescription, CollisionLimits, MenagerieVisuals

_LINKS = ("link_base", "link1", "link2", "link3", "link4", "link5", "link6", "link7")

XARM7: Final = ArmDescription(
    name="xarm7",
    label="UFACTORY xArm 7",
    module=__name__,
    mjcf_file="xarm7.xml",
    base_body="link_base",
    joints=("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"),
    actuators=("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"),
    flange_site="flange",
    # mujoco_menagerie's keyframe; joint 6 is rounded so that the flange points straight down: -q2 + q4 = q6.
    home=(0.0, -0.247, 0.0, 0.909, 0.0, 1.156, 0.0),
    # mujoco_menagerie ufactory_xarm7; xarm_description gives the same, with 2 pi and pi written out.
    joint_lower=(-6.28319, -2.059, -6.28319, -0.19198, -6.28319, -1.69297, -6.28319),
    joint_upper=(6.28319, 2.0944, 6.28319, 3.927, 6.28319, 3.14159, 6.28319),
    # xarm_description, xarm7.urdf.xacro: velocity.
    velocity_limit=(3.14,) * 7,
    # xarm_description has 50, 50, 30, 30, 30, 20, 20 Nm. These do not hold the data sheet's payload in every pose: 10
    # cm before the flange it takes 62, 37 and 32 Nm at joints 2 to 4. The vendor publishes no other figures. Our choice
    # for these three: a quarter more than that, to move it, too.
    effort_limit=(50.0, 78.0, 46.0, 40.0, 30.0, 20.0, 20.0),
    # The vendor's Python SDK cuts joint accelerations at 20 rad/s^2.
    acceleration_limit=(20.0,) * 7,
    # The vendor publishes no limit in the sources below. Our choice: the largest acceleration is reached in 40 ms.
    jerk_limit=(500.0,) * 7,
    # The vendor watches the joints' torques with a sensitivity of 1 to 5, and publishes no torques. Ours for its usual
    # sensitivity of 3: 40 % of the effort limits; the time constant is ours too.
    collision=CollisionLimits(joint_torque=(20.0, 20.0, 12.0, 12.0, 12.0, 8.0, 8.0), time_constant=0.005),
    # Vendor's data sheet: reach 700 mm.
    workspace_reach=0.7,
    # Vendor's data sheet: 3.5 kg.
    payload=3.5,
    sources=(
        "xarm_description (xarm_ros2, BSD-3-Clause): kinematics, limits; efforts of joints 1, 5, 6, 7",
        "UFACTORY xArm 7 data sheet: reach, payload",
        "mujoco_menagerie ufactory_xarm7 (BSD-3-Clause): inertias, armature, friction, servo gains, home pose",
        "xArm-Python-SDK (BSD-3-Clause): largest joint acceleration; that the arm reacts to collisions",
    ),
    menagerie=MenagerieVisuals.of("ufactory_xarm7", "xarm7_nohand", {link: link for link in _LINKS}),
)
"""The UFACTORY xArm 7 arm with seven joints."""
