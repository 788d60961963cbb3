"""Units in which policies were trained, as linear maps to ours."""

from __future__ import annotations

import math

OPENING = "0 closed, 1 open"
"""How a gripper or a hand is told here."""

_OPENINGS = {
    OPENING: (1.0, 0.0),
    "0 open, 1 closed": (-1.0, 1.0),
    "1 closed, 0 open": (-1.0, 1.0),
    "1 open, 0 closed": (1.0, 0.0),
    "-1 closed, 1 open": (0.5, 0.5),
    "-1 open, 1 closed": (-0.5, 0.5),
}
_ANGLES = {"rad": (1.0, 0.0), "deg": (math.pi / 180, 0.0)}


def from_unit(unit: str, ours: str) -> tuple[float, float] | None:
    """Return scale and offset that take a number in a policy's unit to ours; None if they are not convertible.

    Args:
        unit: The policy's; empty for ours.
        ours: The environment's.
    """
    if unit in ("", ours) or ours == "":
        return 1.0, 0.0
    if ours == OPENING:
        return _OPENINGS.get(unit)
    if ours == "rad":
        return _ANGLES.get(unit)
    return None
