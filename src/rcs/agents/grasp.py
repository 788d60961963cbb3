"""Grasps from above: where, and the phases that lead there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ik_options
from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import GRIPPER
from rcs.kinematics import IkStatus
from rcs.spatial import Pose

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]."""
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
    """Plan a grasp with the tool pointing down, tilted as little and with the joints turned as little as may be.

    Args:
        arm: The arm.
        where: Pose whose origin is to be grasped, in the base frame.
        turns: Groups of angles of the tool about the vertical [rad], best first. Within a group, the angle with the
            smallest largest joint motion wins.
        lift: Height to lift to above the grasp [m]; the tasks want 0.10.
        in_tcp: Where the grasped place is along the TCP's x and y [m].

    Returns:
        The poses `above`, `grasp` and `lifted`; None when nothing is feasible.
    """
    kinematics = arm.kinematics

    def reach(height: float, turn: float, start: NDArray[np.float64], restarts: int = 0) -> _Reach | None:
        # A half turn about x points the tool down.
        down = Pose.from_rpy(where.translation + [0.0, 0.0, height], (np.pi, 0.0, turn))
        tool = down * Pose((-in_tcp[0], -in_tcp[1], 0.0))
        result = kinematics.inverse(tool, start, ik_options(kinematics, restarts))
        # An arm with fewer than six joints leans its tool where it must.
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
