"""The figures of the Universal Robots UR5e."""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import Final

from rcs.robots.description import ArmDescription, CollisionLimits, MenagerieBody, MenagerieVisuals, Mount

_HALF = sqrt(0.5)

# The collection's link frames are turned against the vendor's, and lie in the tubes' axes instead of the joints'.
# Those of the wrist by the meshes themselves: tubes around the next joint's axis, the last face in the flange.
_MESHES: Final = MenagerieVisuals(
    model="universal_robots_ur5e",
    entry="ur5e",
    bodies=tuple(
        MenagerieBody(body=body, source=body, source_in_body=Mount(translation=(0.0, 0.0, z), quaternion=quaternion))
        for body, z, quaternion in (
            ("base", 0.0, (0.0, 0.0, 1.0, 0.0)),
            ("shoulder_link", 0.0, (0.0, 0.0, 1.0, 0.0)),
            ("upper_arm_link", 0.138, (0.5, -0.5, -0.5, 0.5)),
            ("forearm_link", 0.007, (0.5, -0.5, -0.5, 0.5)),
            ("wrist_1_link", -0.1263, (_HALF, 0.0, 0.0, _HALF)),
            ("wrist_2_link", -0.0997, (0.0, 0.0, 0.0, 1.0)),
            ("wrist_3_link", -0.0989, (_HALF, 0.0, 0.0, _HALF)),
        )
    ),
)

UR5E: Final = ArmDescription(
    name="ur5e",
    label="Universal Robots UR5e",
    module=__name__,
    mjcf_file="ur5e.xml",
    # The controller's frame `base`. ROS calls it `base_link_inertia`; its `base_link` is turned by pi about z.
    base_body="base",
    joints=(
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ),
    actuators=("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    # The controller's tool0: z out of the flange.
    flange_site="flange",
    # The home pose of mujoco_menagerie: forearm level, the tool points down in front of the base, on its y axis.
    home=(-pi / 2, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0),
    # Universal_Robots_ROS2_Description 2.4.5, config/ur5e/joint_limits.yaml: position, velocity and effort.
    joint_lower=(-2 * pi, -2 * pi, -pi, -2 * pi, -2 * pi, -2 * pi),
    joint_upper=(2 * pi, 2 * pi, pi, 2 * pi, 2 * pi, 2 * pi),
    velocity_limit=(pi,) * 6,
    effort_limit=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    # The vendor limits torques and publishes no accelerations. 5 rad/s^2 is what its own ur_moveit_config plans with,
    # "chosen conservatively"; the jerk is ours: full acceleration after 10 ms.
    acceleration_limit=(5.0,) * 6,
    jerk_limit=(500.0,) * 6,
    # Safety function "force limit" of the vendor's user manual for tool and elbow, 150 N in the factory's settings; the
    # limits of its joints are not published. The time constant is ours.
    collision=CollisionLimits(joint_torque=(inf,) * 6, force=150.0, time_constant=0.005),
    # Vendor's data sheet: reach 850 mm.
    workspace_reach=0.85,
    # Vendor's data sheet: 5 kg.
    payload=5.0,
    sources=(
        "Universal_Robots_ROS2_Description 2.4.5 (BSD-3-Clause): kinematics, limits, masses, inertias",
        "UR5e data sheet: reach, payload",
        "Universal_Robots_ROS2_Driver ur_moveit_config (BSD-3-Clause): accelerations, a conservative choice",
        "UR5e user manual: force limit of the safety system",
        "mujoco_menagerie universal_robots_ur5e (BSD-3-Clause): armature, servo gains, home pose",
    ),
    menagerie=_MESHES,
)
"""The UR5e arm with six joints."""
