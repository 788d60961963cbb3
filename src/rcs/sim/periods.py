"""Periods in steps of the physics: that of control, and those at which functions are called."""

from __future__ import annotations

import math
from fractions import Fraction

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
    if not (math.isfinite(physics_step) and physics_step >= SHORTEST_PHYSICS_STEP):
        raise InvalidSetup(f"The model's time step is {physics_step} s; it must be at least {SHORTEST_PHYSICS_STEP} s.")
    if not (math.isfinite(frequency) and LOWEST_FREQUENCY <= frequency <= 1 / physics_step + 1e-9):
        raise InvalidSetup(
            f"frequency is {frequency} Hz; valid is from {LOWEST_FREQUENCY} Hz up to the physics' "
            f"{1 / physics_step:g} Hz."
        )
    return 1 / (Fraction(frequency).limit_denominator(10**6) * Fraction(physics_step).limit_denominator(10**9))


def require_multiple(period: float, physics_step: float) -> None:
    """Check that a period is a multiple of the physics' time step; the core refuses what is shorter or not finite.

    Args:
        period: Time between two calls [s].
        physics_step: Time step of the physics [s].

    Raises:
        InvalidSetup: It is between two multiples; the message has both.
    """
    steps = period / physics_step
    if 0.5 <= steps < math.inf and not math.isclose(steps, round(steps), rel_tol=1e-9):
        fewer = max(math.floor(steps), 1)
        nearest = " and ".join(f"{round(n * physics_step, 12)} s" for n in (fewer, fewer + 1))
        raise InvalidSetup(
            f"The period is {period} s; valid is a multiple of the physics' time step of {physics_step} s. The nearest "
            f"are {nearest}."
        )
