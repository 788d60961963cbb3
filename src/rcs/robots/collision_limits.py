"""When an arm takes what it feels for a collision and stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from rcs.errors import InvalidSetup

Loads = Literal["outer", "drive"]
"""What an arm watches at its joints: what presses on it from outside, or all that its drives exert."""


@dataclass(frozen=True, kw_only=True)
class CollisionLimits:
    """Limits of the forces on an arm. An arm that exceeds one goes into its fault state.

    What presses on an arm from outside is felt through its observer. A momentum observer, as arms with known dynamics
    have, gives the outer torques through a first-order filter (De Luca and Mattone 2005, Haddadin et al. 2017).
    """

    joint_torque: tuple[float, ...]
    """Largest torque at each joint [Nm]; infinite for none."""
    loads: Loads = "outer"
    """Which torques are meant."""
    force: float = math.inf
    """Largest outer force along each axis of the base [N]."""
    moment: float = math.inf
    """Largest outer moment about the TCP along each axis of the base [Nm]."""
    time_constant: float = 0.0
    """Of the observer [s]; 0 for none."""
    duration: float = 0.0
    """How long a limit must be exceeded [s]."""

    def __post_init__(self) -> None:
        """Check the signs.

        Raises:
            InvalidSetup: A limit is not above 0, or a time is negative or not finite.
        """
        if not all(limit > 0.0 for limit in (*self.joint_torque, self.force, self.moment)):
            raise InvalidSetup(
                f"Collision limits must be above 0; got torques of {self.joint_torque} Nm, a force of {self.force} N "
                f"and a moment of {self.moment} Nm."
            )
        for name in ("time_constant", "duration"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InvalidSetup(f"The {name} of collision limits is {getattr(self, name)} s; valid is from 0 s.")
