"""Options that the drivers of UR and xArm arms share."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta
from rcs_data.options import Record

from rcs.devices import ArmLimits
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription
from rcs.spatial import Pose

TURN_PER_METRE = 4.0
"""Ratio of the TCP's limits of rotation and translation [rad/m]; our choice."""


class ArmOptions(Record):
    """A site's options for an arm."""

    speed: Annotated[float, Meta(ge=0.01, le=1.0)] = 1.0
    """Fraction of the description's joint speeds."""
    tcp: tuple[float, float, float, float, float, float, float] | None = None
    """Pose of the TCP in the flange as translation [m] and quaternion xyzw, required for poses and twists."""
    tcp_speed: Annotated[float, Meta(ge=0.001, le=1.0)] = 0.25
    """Limit of the TCP's speed for poses and twists [m/s]. The default is that of ISO 10218-1 for teaching next to
    people."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A value is invalid.
        """
        super().__post_init__()
        self.tcp_in_flange()

    def tcp_in_flange(self) -> Pose | None:
        """Return the TCP's pose in the flange; None if there is no TCP."""
        try:
            return None if self.tcp is None else Pose.from_tquat(self.tcp)
        except ValueError as err:
            raise InvalidSetup(f"tcp is {self.tcp}; valid: a translation [m] and a quaternion xyzw. {err}.") from err

    def limits(self, about: ArmDescription) -> ArmLimits:
        """Return an arm's limits, with this fraction of its joint speeds."""
        return ArmLimits(
            list(about.joint_lower),
            list(about.joint_upper),
            [self.speed * value for value in about.velocity_limit],
            joint_acceleration=list(about.acceleration_limit),
            joint_jerk=list(about.jerk_limit),
            joint_effort=list(about.effort_limit),
        )
