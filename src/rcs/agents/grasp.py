"""Grasps from above: their poses, and the phases that lead to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import GRIPPER
from rcs.kinematics import IkStatus, freedom_of
from rcs.spatial import Pose, tquat_to_matrix

CLEARANCE = 0.09
"""Height of the pre-grasp above the grasp [m]."""
SETTLING_TIME = 0.1
"""Earliest time after arriving at which standing still means that the servos have arrived, too [s]."""
CLOSING_TIME = 0.3
"""Earliest time after the command to close at which standing still means closed [s]."""
BARELY_CLOSED = 0.9
"""Opening above which nothing is grasped: no object here is this wide in proportion to the gripper."""
STILL = 0.06
"""Speed of the opening below which a gripper stands still [1/s]."""
EMPTY = 0.05
"""Opening below which nothing is grasped: empty jaws close to 0, those of an SO101 on its cuboid to 0.1."""


def are_still(script: Script) -> bool:
    """Return whether all grippers stood still between their latest two readings."""
    pairs = [(arm.openings[0], arm.openings[-1]) for arm in script.arms]
    return all(abs(now - before) < STILL * (at - earlier) for (earlier, before), (at, now) in pairs)


def have_closed(script: Script) -> bool:
    """Return whether all grippers stand still, closed on something or on nothing."""
    have_moved = all(float(arm.observation[GRIPPER][0]) < BARELY_CLOSED for arm in script.arms)
    return script.elapsed > CLOSING_TIME and have_moved and are_still(script)


def are_empty(script: Script) -> bool:
    """Return whether a gripper has nothing between its jaws."""
    return any(float(arm.observation[GRIPPER][0]) < EMPTY for arm in script.arms)


REACH = (
    Phase("approach", "above", 0.45),
    Phase("descend", "grasp"),
    Phase("settle", "grasp", until=lambda script: script.elapsed >= SETTLING_TIME and script.is_still()),
)
"""Leads to a grasp from above."""
CLOSE = Phase("close", "grasp", opening=0.0, until=have_closed, risk=("no_contact", are_empty), is_judged_at_end=True)
"""For a gripper with a measured opening."""


Reach = tuple[NDArray[np.float64], NDArray[np.float64]]
"""A TCP pose (7,) and the joints that reach it [rad]."""


def reach(arm: ScriptedArm, tool: Pose, start: NDArray[np.float64], restarts: int = 0) -> Reach | None:
    """Return how an arm reaches a pose; None if it cannot. With fewer than six joints it may have to tilt its tool."""
    kinematics = arm.kinematics
    result = kinematics.inverse(tool, start, freedom_of(kinematics, restarts=restarts))
    tcp = tool if kinematics.dof >= 6 else kinematics.forward(result.joints)
    return (tcp.tquat, result.joints) if result.status == IkStatus.ok else None


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
    for group in turns:
        ways = ways_from_above(arm, where, group, lift=lift, in_tcp=in_tcp)
        if ways:
            return min(ways, key=lambda way: float(np.abs(way[1] - arm.start).max()))[0]
    return None


def ways_from_above(
    arm: ScriptedArm,
    where: Pose,
    turns: Sequence[float],
    *,
    lift: float = 0.15,
    in_tcp: tuple[float, float] = (0.0, 0.0),
    lean: float = 0.0,
) -> list[tuple[Plan, NDArray[np.float64]]]:
    """Return the feasible plans of `plan_from_above`, and the joints of their grasps [rad].

    Args:
        arm: The arm.
        where: Pose in the base frame whose origin to grasp.
        turns: Angles of the tool about the vertical [rad].
        lift: Height to lift above the grasp [m].
        in_tcp: Grasped point along the TCP's x and y [m].
        lean: How far the hand leans away from the base, its fingers towards it [rad].
    """
    x, y, _ = where.translation
    leaning = Pose.from_rotvec((0.0, 0.0, 0.0), np.array([-y, x, 0.0]) * (lean / np.hypot(x, y)))
    ways: list[tuple[Plan, NDArray[np.float64]]] = []
    for turn in turns:
        # A half turn about x points the tool down.
        down = leaning * Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, turn))
        tool = Pose(where.translation, down.quaternion) * Pose((-in_tcp[0], -in_tcp[1], 0.0))
        above = reach(arm, raised(tool, CLEARANCE), arm.start, restarts=10)
        grasp, lifted = (above and reach(arm, raised(tool, height), above[1]) for height in (0.0, lift))
        if above and grasp and lifted:
            ways.append(({"above": above[0], "grasp": grasp[0], "lifted": lifted[0]}, grasp[1]))
    return ways


def closing_yaw(pose: NDArray[np.float64], edges: Sequence[float]) -> NDArray[np.float64]:
    """Return the turn of a tool about the vertical with which its jaws close across the shorter level edge of boxes.

    Args:
        pose: Poses of the boxes in the base frame, (*leading, 7).
        edges: Edges along their x, y, z [m], (3,) or (*leading, 3).

    Returns:
        Angles [rad], (*leading,). The opposite ones do as well.
    """
    axes = tquat_to_matrix(pose)[..., :3, :3]
    # The axis that points up or down does not count.
    lengths = np.where(
        np.abs(axes[..., 2, :]) == np.abs(axes[..., 2, :]).max(axis=-1, keepdims=True), np.inf, np.asarray(edges)
    )
    shortest = np.argmin(lengths, axis=-1)[..., None, None]
    across = np.take_along_axis(axes, shortest, axis=-1)[..., 0]
    return np.arctan2(-across[..., 0], across[..., 1])


def raised(pose: Pose, height: float) -> Pose:
    """Return a pose that is higher by some metres."""
    return Pose((0.0, 0.0, height)) * pose
