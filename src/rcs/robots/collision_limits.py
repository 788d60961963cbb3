"""Limits at which an arm takes forces for a collision and stops."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from rcs_data.record import INFINITE, Meta, NotNegative, Record

Limit = Annotated[float, Meta(gt=0), INFINITE]
Loads = Literal["outer", "drive"]
"""Torques that an arm watches at its joints: those from outside, or all that its drives exert."""


class CollisionLimits(Record):
    """Limits of the forces on an arm. An arm that exceeds one goes into its fault state.

    What presses on an arm from outside is felt through its observer. A momentum observer, as arms with known dynamics
    have, gives the outer torques through a first-order filter (De Luca and Mattone 2005, Haddadin et al. 2017).
    """

    joint_torque: tuple[Limit, ...]
    """Largest torque at each joint [Nm]; infinite for none."""
    loads: Loads = "outer"
    """The torques that are compared with them."""
    force: Limit = math.inf
    """Largest outer force along each axis of the base [N]."""
    moment: Limit = math.inf
    """Largest outer moment about the TCP along each axis of the base [Nm]."""
    time_constant: NotNegative = 0.0
    """Time constant of the observer [s]; 0 for none."""
    duration: NotNegative = 0.0
    """How long a limit must be exceeded [s]."""
