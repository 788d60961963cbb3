"""The figures of the Franka Research 3."""

from __future__ import annotations

from math import pi
from typing import Final

from rcs.robots.description import ArmDescription, CollisionLimits, MenagerieVisuals

FR3: Final = ArmDescription(
    name="fr3",
    label="Franka Research 3",
    module=__name__,
    mjcf_file="fr3.xml",
    base_body="link0",
    joints=("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"),
    actuators=("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"),
    flange_site="flange",
    # Start pose of the vendor's libfranka examples: the hand points down and its fingers open along the base's y axis.
    home=(0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
    # franka_description 1.0.1, robots/fr3/joint_limits.yaml: position, velocity and effort.
    joint_lower=(-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
    joint_upper=(2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
    velocity_limit=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    effort_limit=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # libfranka, rate_limiting.h: the same for all joints; the library itself stays 1e-3 below.
    acceleration_limit=(10.0,) * 7,
    jerk_limit=(5000.0,) * 7,
    # Torques: the vendor's franka_ros franka_control_node.yaml and libfranka's examples of motions. Forces and moments:
    # libfranka's examples with contact; those of free motion are 20 N and 25 Nm. The vendor publishes no figure of its
    # observer; the time constant is ours.
    collision=CollisionLimits(
        joint_torque=(20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0), force=100.0, moment=100.0, time_constant=0.005
    ),
    # Vendor's data sheet: maximum reach 855 mm.
    workspace_reach=0.855,
    # Vendor's data sheet: 3 kg.
    payload=3.0,
    sources=(
        "franka_description 1.0.1 (Apache-2.0): kinematics, limits, inertia of the base",
        "Franka Research 3 data sheet: reach, payload",
        "libfranka include/franka/rate_limiting.h (Apache-2.0): acceleration and jerk limits",
        "franka_ros franka_control_node.yaml, libfranka examples (Apache-2.0): collision thresholds",
        "mujoco_menagerie franka_fr3 (Apache-2.0): inertias, armature, friction, servo gains, measures of the shapes",
    ),
    menagerie=MenagerieVisuals.of("franka_fr3", "fr3", {f"link{i}": f"fr3_link{i}" for i in range(8)}),
)
"""The Franka Research 3 arm with seven joints."""
