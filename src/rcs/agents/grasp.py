"""Grasps from above: where, and the phases that lead there."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ik_options
from rcs.agents.script import Phase, Plan, Script, ScriptedArm, Waypoint
from rcs.envs.spaces import GRIPPER
from rcs.kinematics import IkStatus
from rcs.spatial import Pose

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]."""
TILTS = tuple(np.deg2rad([0.0, 15.0, -15.0, 30.0, -30.0, 45.0, 60.0, 75.0, 90.0]).tolist())
"""Angles by which the tool of an arm with fewer than six joints may lean away from the base, best first [rad]."""
CLOSING_TIME = 0.3
"""A gripper that stands still sooner than this after the command to close [s] has not yet begun to."""
BARELY_CLOSED = 0.9
"""Nothing that is to be grasped here is this wide in proportion to the gripper."""
STILL = 2e-3
"""The gripper counts as still when its opening changes by less than this per step."""
EMPTY = 0.05
"""An opening below this has nothing in it: empty jaws close to 0, and those of an SO101 on its cuboid to 0.1."""


def have_closed(script: Script) -> bool:
    """Return whether all grippers stand still, closed on something or on nothing."""
    pairs = [(float(arm.observation[GRIPPER][0]), float(arm.before[GRIPPER][0])) for arm in script.arms]
    are_still = all(now < BARELY_CLOSED and abs(now - before) < STILL for now, before in pairs)
    return script.elapsed > CLOSING_TIME and are_still


def are_empty(script: Script) -> bool:
    """Return whether a gripper has nothing between its jaws."""
    return any(float(arm.observation[GRIPPER][0]) < EMPTY for arm in script.arms)


REACH = (
    Phase("approach", "above", 0.45),
    Phase("descend", "grasp"),
    Phase("settle", "grasp", until=lambda script: script.elapsed >= 0.1),  # [s], for the servo lag to die out
)
"""Leads to a grasp from above."""
CLOSE = Phase("close", "grasp", opening=0.0, until=have_closed, risk=("no_contact", are_empty), is_judged_at_end=True)
"""For a gripper that says how far it is open."""


def plan_from_above(
    arm: ScriptedArm,
    where: Pose,
    turns: Sequence[Sequence[float]],
    *,
    lift: float = 0.15,
    in_tcp: tuple[float, float] = (0.0, 0.0),
) -> Plan | None:
    """Plan a grasp with the tool pointing down, tilted as little and with the joints turned as little as may be.

    Args:
        arm: The arm.
        where: Pose whose origin is to be grasped, in the base frame.
        turns: Angles of the tool about the vertical [rad], best first; of several in one group, the one is taken whose
            largest joint motion is the smallest.
        lift: Height to lift to above the grasp [m]; the tasks want 0.10.
        in_tcp: Where the grasped place is along the TCP's x and y [m].

    Returns:
        The waypoints `above`, `grasp` and `lifted`; None when nothing is feasible.
    """
    tilts = TILTS if arm.kinematics.dof < 6 else (0.0,)
    x, y = where.translation[:2] - _first_axis(arm)
    azimuth = float(np.arctan2(y, x))

    def tool(tilt: float, turn: float, height: float) -> Pose:
        # About the horizontal axis across the arm's plane, so that an arm with five joints can follow. A half turn
        # about x then points the tool down.
        lean = Pose.from_rotvec((0, 0, 0), (tilt * np.sin(azimuth), -tilt * np.cos(azimuth), 0.0))
        place = Pose(where.translation + [0.0, 0.0, height])
        return place * lean * Pose.from_rpy((0, 0, 0), (np.pi, 0.0, turn)) * Pose((-in_tcp[0], -in_tcp[1], 0.0))

    def solved(tcp: Pose, start: NDArray[np.float64], restarts: int = 0) -> NDArray[np.float64] | None:
        result = arm.kinematics.inverse(tcp, start, ik_options(arm.kinematics, restarts))
        return result.joints if result.status == IkStatus.ok else None

    def way(tilt: float, turn: float) -> tuple[float, Plan] | None:
        high, grasp = tool(tilt, turn, CLEARANCE), tool(tilt, turn, 0.0)
        above = solved(high, arm.start, restarts=10)
        down = None if above is None else solved(grasp, above)
        if above is None or down is None:
            return None
        for other in sorted(tilts, key=lambda angle: abs(angle - tilt)):
            lifted = tool(other, turn, lift)
            if (up := solved(lifted, above)) is not None:
                # Between two poses that an arm with five joints can reach there are poses that it cannot.
                first, last = (above, up) if arm.kinematics.dof < 6 else (None, None)
                ends = {"above": Waypoint(high.tquat, first), "lifted": Waypoint(lifted.tquat, last)}
                return float(np.abs(down - arm.start).max()), {**ends, "grasp": Waypoint(grasp.tquat)}
        return None

    for tilt, group in itertools.product(tilts, turns):
        if ways := [found for turn in group if (found := way(tilt, turn)) is not None]:
            return min(ways, key=lambda found: found[0])[1]
    return None


def _first_axis(arm: ScriptedArm) -> NDArray[np.float64]:
    """Return x, y of the first joint's axis in the base frame [m]; the axis must be upright."""
    turned = arm.start.copy()
    turned[0] += 1.0 if turned[0] < 0 else -1.0
    turn = (arm.kinematics.forward(turned) * arm.kinematics.forward(arm.start).inverse()).matrix
    # A point c of the axis has R c + t = c.
    return np.asarray(np.linalg.solve(np.eye(2) - turn[:2, :2], turn[:2, 3]), np.float64)
