"""What an arm's number of joints lets inverse kinematics ask for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rcs._core import IkOptions, Kinematics

POSE = 6
"""Joints that it takes to reach any pose near another."""
FOLLOWED = 1e-5
"""Tolerance of a followed pose [m] and [rad]: at 100 Hz, a target at 1 mm/s moves by this much per step."""


def freedom_of(
    kinematics: Kinematics,
    *,
    restarts: int = 0,
    best_effort: bool = False,
    preferred: ArrayLike | None = None,
    max_step: ArrayLike | None = None,
) -> IkOptions:
    """Return solver options for what an arm can reach: any pose, or with fewer than six joints, a position.

    The tool of an arm with fewer than six joints leans as little as possible, by up to 1.6 rad. An arm with more than
    six returns to its preferred joints while its TCP moves.

    Args:
        kinematics: Of the arm.
        restarts: Random starts where the target is not reached from the start; 0 keeps to the branch of the start.
        best_effort: Whether to follow a target that is out of reach as near as possible.
        preferred: Joints to return to [rad], shape (dof,); None for none. Arms with six joints or fewer have no choice.
        max_step: Largest change of each joint from the start [rad], shape (dof,); None for no bound.
    """
    has_spare = preferred is not None and kinematics.dof > POSE
    preferred = np.asarray(preferred, np.float64) if has_spare else None
    step = None if max_step is None else np.asarray(max_step, np.float64)
    if kinematics.dof >= POSE:
        # What follows slowly must not wait until the target has left the tolerance and then jump.
        tolerance = FOLLOWED if best_effort else IkOptions().translation_tolerance
        return IkOptions(
            restarts=restarts,
            iterations=100,
            translation_tolerance=tolerance,
            rotation_tolerance=tolerance,
            best_effort=best_effort,
            preferred=preferred,
            max_step=step,
        )
    # With this weight, a tilt of a right angle moves the solution by less than the tolerance of the position. Damping
    # that is not small against its square would let the tilt creep to its best, a few percent of the way at a time.
    return IkOptions(
        restarts=restarts,
        iterations=200,
        rotation_weight=0.005,
        damping=1e-6,
        rotation_tolerance=1.6,
        translation_tolerance=5e-4,
        best_effort=best_effort,
        max_step=step,
    )
