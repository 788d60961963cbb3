"""Grasps from above: their poses, and the phases that lead to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import GRIPPER
from rcs.kinematics import IkStatus, freedom_of
from rcs.spatial import Pose

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]."""
CLOSING_TIME = 0.3
"""Earliest time after the command to close at which standing still means closed [s]."""
BARELY_CLOSED = 0.9
"""Opening above which nothing is grasped: no object here is this wide in proportion to the gripper."""
STILL = 2e-3
"""Change of the opening per step below which a gripper stands still."""
EMPTY = 0.05
"""Opening below which nothing is grasped: empty jaws close to 0, those of an SO101 on its cuboid to 0.1."""


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
    Phase("settle", "grasp", until=lambda script: script.elapsed >= 0.1),  # [s], until the servo lag has died out
)
"""Leads to a grasp from above."""
CLOSE = Phase("close", "grasp", opening=0.0, until=have_closed, risk=("no_contact", are_empty), is_judged_at_end=True)
"""For a gripper with a measured opening."""


_Reach = tuple[NDArray[np.float64], NDArray[np.float64]]
"""A TCP pose (7,) and the joints that reach it [rad]."""


def plan_from_above(
    arm: ScriptedArm,
    where: Pose,
    turns: Sequence[Sequence[float]],
    *,
    lift: float = 0.15,
    in_tcp: tuple[float, float] = (0.0, 0.0),
) -> Plan | None:
    """Plan a grasp with the tool pointing down, with the least tilt and joint motion.

    Args:
        arm: The arm.
        where: Pose in the base frame whose origin to grasp.
        turns: Groups of angles of the tool about the vertical [rad], best first. Within a group, the angle with the
            smallest largest joint motion wins.
        lift: Height to lift above the grasp [m]; the tasks require 0.10.
        in_tcp: Grasped point along the TCP's x and y [m].

    Returns:
        The poses `above`, `grasp` and `lifted`; None if nothing is feasible.
    """
    kinematics = arm.kinematics

    def reach(height: float, turn: float, start: NDArray[np.float64], restarts: int = 0) -> _Reach | None:
        # A half turn about x points the tool down.
        down = Pose.from_rpy(where.translation + [0.0, 0.0, height], (np.pi, 0.0, turn))
        tool = down * Pose((-in_tcp[0], -in_tcp[1], 0.0))
        result = kinematics.inverse(tool, start, freedom_of(kinematics, restarts=restarts))
        # An arm with fewer than six joints may have to tilt its tool.
        tcp = tool if kinematics.dof >= 6 else kinematics.forward(result.joints)
        return (tcp.tquat, result.joints) if result.status == IkStatus.ok else None

    for group in turns:
        ways: list[tuple[float, Plan]] = []
        for turn in group:
            above = reach(CLEARANCE, turn, arm.start, restarts=10)
            grasp, lifted = (above and reach(height, turn, above[1]) for height in (0.0, lift))
            if above and grasp and lifted:
                motion = float(np.abs(grasp[1] - arm.start).max())
                ways.append((motion, {"above": above[0], "grasp": grasp[0], "lifted": lifted[0]}))
        if ways:
            return min(ways, key=lambda way: way[0])[1]
    return None
