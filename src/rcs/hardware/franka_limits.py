"""Velocity limits of the FR3's joints, which decrease towards the ends of their ranges."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rcs.devices import ArmLimits
from rcs.robots.description import ArmDescription

# franka_description 1.0.1, robots/fr3/joint_limits.yaml: deceleration limit [rad/s²] and velocity offset [rad/s].
DECELERATION_LIMIT: Final = np.array([6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0])
VELOCITY_OFFSET: Final = np.array([0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35])

STEADY_VELOCITY: Final = np.array([2.0, 1.5, 1.5, 1.15, 3.0, 1.5, 3.0])
"""Speeds that are admissible in most of each range [rad/s]; our choice, like the vendor's constant limits."""
OVERSHOOT: Final = 1.05
"""Largest ratio of measured to commanded speed; our choice."""

Vector = NDArray[np.float64]


def velocity_bounds(about: ArmDescription, joints: Vector) -> tuple[Vector, Vector]:
    """Return the smallest and the largest velocities that an FR3 admits [rad/s], shape (7,) each.

    Formula: libfranka (Apache-2.0), joint_velocity_limits.h.

    Args:
        about: Description of the arm.
        joints: Joint positions [rad], shape (7,).
    """
    fastest = np.array(about.velocity_limit)

    def bound(way: Vector) -> Vector:
        return np.clip(np.sqrt(2.0 * DECELERATION_LIMIT * np.maximum(way, 0.0)) - VELOCITY_OFFSET, 0.0, fastest)

    return -bound(joints - np.array(about.joint_lower)), bound(np.array(about.joint_upper) - joints)


def limits_of_fr3(about: ArmDescription, *, speed: float = 1.0, whole_range: bool = False) -> ArmLimits:
    """Return the limits for controlling an FR3.

    Args:
        about: Description of the arm.
        speed: Fraction of the speed limits to use.
        whole_range: Use the full ranges and speeds. By default they are reduced such that a joint that moves at full
            speed and brakes to stop at the end of its range never exceeds the robot's limit at its position.
    """
    lower, upper, fastest = np.array(about.joint_lower), np.array(about.joint_upper), np.array(about.velocity_limit)
    fastest = speed * (fastest if whole_range else np.minimum(fastest, STEADY_VELOCITY))
    if not whole_range:
        speeds = np.linspace(
            0.0, fastest, 200
        )  # distance from the joint's end needed at each, less the braking distance
        needed = (OVERSHOOT * speeds + VELOCITY_OFFSET) ** 2 / (2.0 * DECELERATION_LIMIT)
        margin = (needed - speeds**2 / (2.0 * np.array(about.acceleration_limit))).max(axis=0)
        lower, upper = lower + margin, upper - margin
    return ArmLimits(
        list(lower),
        list(upper),
        list(fastest),
        joint_acceleration=list(about.acceleration_limit),
        joint_jerk=list(about.jerk_limit),
        joint_effort=list(about.effort_limit),
    )
