"""Checks the motion of an episode: joints beyond their limits, and impossible jumps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.report import Finding, counted
from rcs_data.files.joint_bounds import JointBounds

# Tolerance of joint limits [rad]: simulated limits are springs, and encoders have offsets.
_BEYOND = 0.02
# Factor by which a step may exceed the velocity limit, and an allowance [rad] for noise of encoders and time stamps.
_FASTER = 1.25
_NOISE = 0.02
# A jump of an unknown arm is this many times the steps around it, and faster than any arm [rad/s].
_OUTLIER = 8.0
_FASTEST = 6.5


def check_motion(place: EpisodePlace, rows: EpisodeRows) -> Iterator[Finding]:
    """Yield findings about the motion of an episode."""
    for key in rows.joints:
        joints = rows.column(key)
        if joints is None or joints.ndim != 2 or len(joints) < 2:
            continue
        joints = np.where(np.isfinite(joints), joints, np.nan)  # values that are not finite are reported elsewhere
        limits = rows.info.feature(key).limits
        if limits is not None:
            lower, upper = np.array(limits.lower), np.array(limits.upper)
            beyond = np.nan_to_num(np.maximum(lower - joints, joints - upper))
            outside = np.flatnonzero(beyond.max(axis=1) > _BEYOND)
            if len(outside):
                names = _joints(limits, beyond.max(axis=0) > _BEYOND)
                message = f"{key!r}: {names} up to {beyond.max():.3f} rad beyond the limits of {limits.arm}"
                yield place.warning("joint_limit", f"{message}, in {counted(len(outside), 'row')}", outside)
        jumps = _jumps(joints, rows.seconds_per_step(), limits)
        touched = np.flatnonzero(jumps.any(axis=1)) + 1
        if len(touched):
            steps = _steps(joints)
            by = (
                f"faster than {limits.arm} can move"
                if limits is not None
                else "out of proportion to the steps around it"
            )
            times = counted(len(touched), "step")
            message = f"{key!r} jumps by up to {steps[jumps].max():.2f} rad in a step, {by}, in {times}"
            yield place.warning("joint_jump", message, touched)


def _jumps(joints: NDArray[np.float64], seconds: NDArray[np.float64], limits: JointBounds | None) -> NDArray[np.bool_]:
    """Return which steps of which joints are impossible, shape (length - 1, dof)."""
    steps = _steps(joints)
    if limits is not None:
        return steps > _FASTER * np.array(limits.velocity) * seconds[:, None] + _NOISE
    # The median of the two steps before and after, so that a spike does not hide itself. Unknown steps count as long,
    # so that no other one stands out because of them.
    known = np.where(np.isfinite(np.diff(joints, axis=0)), steps, np.inf)
    padded = np.pad(known, ((2, 2), (0, 0)), mode="edge")
    around = np.median([padded[i : i + len(steps)] for i in (0, 1, 3, 4)], axis=0)
    return (steps > _OUTLIER * around) & (steps > _FASTEST * seconds[:, None] + _NOISE)


def _steps(joints: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.nan_to_num(np.abs(np.diff(joints, axis=0)))


def _joints(limits: JointBounds, which: NDArray[np.bool_]) -> str:
    return ", ".join(name for name, is_named in zip(limits.names, which, strict=True) if is_named)
