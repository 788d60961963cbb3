"""The devices of a site for one setup."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rcs.devices import Arm, Camera, Gripper, Hand

OnStale = Literal["flag", "hold", "fault"]
"""Reaction to a camera without new frames: a flag in recordings, holding all devices, or the end of the episode."""


@dataclass(frozen=True, kw_only=True)
class Devices:
    """The devices of a site for one setup, not yet opened."""

    arms: Mapping[str, Arm] = field(default_factory=dict[str, Arm])
    """Arms by robot."""
    effectors: Mapping[str, Gripper | Hand] = field(default_factory=dict[str, Gripper | Hand])
    """Grippers and hands by robot."""
    cameras: Mapping[str, Camera] = field(default_factory=dict[str, Camera])
    """Cameras by name."""
    tactile: Mapping[str, Camera] = field(default_factory=dict[str, Camera])
    """Cameras of tactile sensors by sensor."""
    tcp: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """The site's option `tcp` by robot, where given: the pose of the TCP in the flange that the controller uses,
    translation [m] and quaternion xyzw."""
    platform: Mapping[str, str] = field(default_factory=dict[str, str])
    """Driver name of every real part: a robot, `robot/end effector`, a camera or a sensor."""
    site: str | None = None
    """SHA-256 of what the site says of them: drivers, addresses, options and times; None without any."""
    valid_for: float | None = None
    """Time for which a command is valid without a new one [s]; None for three control periods."""
    stale_after: float = 0.5
    """Age from which a frame, or a measurement of a gripper or hand, counts as stale [s]."""
    arm_stale_after: float = 0.25
    """Age from which an arm's measurement counts as stale [s]."""
    on_stale: OnStale = "fault"
    """Reaction to a stale camera."""

    def __bool__(self) -> bool:
        """Return True if any device is real."""
        return bool(self.platform)
