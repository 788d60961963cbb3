"""Control periods as exact ratios of physics steps."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from rcs.errors import InvalidSetup

LOWEST_FREQUENCY = 1e-6
"""Lowest control rate [Hz]: one step in eleven days."""

SHORTEST_PHYSICS_STEP = 1e-9
"""Shortest time step of the physics [s], the resolution of control periods."""


def control_period(frequency: float, physics_step: float) -> Fraction:
    """Return the control period in physics steps as an exact ratio, so that the mean rate is exact.

    Args:
        frequency: Control steps per second [Hz].
        physics_step: Time step of the physics [s].

    Raises:
        InvalidSetup: The frequency is too low or higher than that of the physics, or the physics has no time step.
    """
    if not (np.isfinite(physics_step) and physics_step >= SHORTEST_PHYSICS_STEP):
        raise InvalidSetup(f"The model's time step is {physics_step} s; it must be at least {SHORTEST_PHYSICS_STEP} s.")
    if not (np.isfinite(frequency) and LOWEST_FREQUENCY <= frequency <= 1 / physics_step + 1e-9):
        raise InvalidSetup(
            f"frequency is {frequency} Hz; valid is from {LOWEST_FREQUENCY} Hz up to the physics' "
            f"{1 / physics_step:g} Hz."
        )
    return 1 / (Fraction(frequency).limit_denominator(10**6) * Fraction(physics_step).limit_denominator(10**9))
