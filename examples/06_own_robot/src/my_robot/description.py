"""The figures of our arm, read from its MJCF."""

from __future__ import annotations

from math import pi
from typing import Final

from rcs.robots import ArmDescription

JOINTS: Final = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6")

MY_ROBOT: Final = ArmDescription(
    name="my_robot",
    label="My robot",
    module=__name__,
    mjcf_file="my_robot.xml",
    base_body="base",
    joints=JOINTS,
    actuators=JOINTS,
    flange_site="flange",
    # Elbow up, tool down. The last joint undoes the 45 degrees by which the Franka Hand is turned on a flange, so that
    # its fingers open along the base's y axis.
    home=(0.0, 0.0, pi / 2, pi / 2, 0.0, pi / 4),
    joint_lower=(-2.9, -1.8, -2.6, -2.2, -2.0, -3.0),
    joint_upper=(2.9, 1.8, 2.6, 2.2, 2.0, 3.0),
    velocity_limit=(2.5, 2.5, 2.5, 4.0, 4.0, 4.0),
    acceleration_limit=(15.0,) * 6,
    jerk_limit=(1000.0,) * 6,
    effort_limit=(150.0, 150.0, 150.0, 30.0, 30.0, 30.0),
    # Upper arm, forearm and wrist stretched: 0.40 + 0.36 + 0.16 m.
    workspace_reach=0.92,
    sources=("Invented for this example",),
)
"""Our arm."""
