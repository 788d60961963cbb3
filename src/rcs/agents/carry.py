"""Experts that carry a cuboid to a place, set it down there and let go of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.agents.experts import across
from rcs.agents.grasp import CLEARANCE, CLOSE, CLOSING_TIME, REACH, are_empty, are_still, plan_from_above, reach
from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import JOINTS, TQUAT
from rcs.spatial import Pose

DROP = 0.001
"""Height above its goal at which a cuboid is let go [m]."""
WAIT = 2.0
"""Time after letting go at which a cuboid that does not lie where it belongs is picked up once more [s]."""
LEANS = np.deg2rad([0.0, -15.0, -30.0, 15.0, 30.0])
"""Angles by which an arm with fewer than six joints tries to lean its hand, positive away from its base [rad].

It has to lean at far places, and can set a cuboid down flat only if it leant as much when it grasped it.
"""
TURNS = np.deg2rad([0.0, 5.0, -5.0, 10.0, -10.0, 15.0, -15.0])
"""Turns of the cuboid that such an arm tries at the goal, besides that of its base [rad]."""
TILT_COST = 20.0
"""Largest motion of a joint that is as bad as setting the cuboid down at an angle of 1 rad [rad]."""


def have_opened(script: Script) -> bool:
    """Return whether all grippers stand still after opening."""
    return script.elapsed > CLOSING_TIME and are_still(script)


IN_HAND = ("slip", are_empty)
CARRY = (
    *REACH,
    CLOSE,
    Phase("lift", "lifted", opening=0.0, risk=IN_HAND),
    Phase("carry", "over", 0.35, 0.0, risk=IN_HAND),
    Phase("lower", "down", 0.10, 0.0, risk=IN_HAND),
    Phase("rest", "down", opening=0.0, until=REACH[-1].until, risk=IN_HAND),
    Phase("release", "down", until=have_opened),
    Phase("withdraw", "away", risk=("dropped", lambda script: script.elapsed > WAIT)),
)


class PlaceExpert(Script):
    """Carries the cuboid at `info["cuboid"]` to `info["goal"]`, at the yaw that suits the arm best."""

    task = "Place"
    needs = ("cuboid", "goal")
    phases = CARRY

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp and setting down."""
        return plan_carry(arm, *poses_of(self))

    def prepare(self, phase: Phase) -> None:
        """Aim again when the cuboid is in the hand."""
        if phase.name == "carry":
            aim(self)


class StackExpert(Script):
    """Carries the cuboid at `info["cuboid"]` to `info["goal"]` and turns it along what is below, if the arm can."""

    task = "Stack"
    needs = ("cuboid", "goal")
    phases = CARRY

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp and setting down."""
        return plan_carry(arm, *poses_of(self), is_aligned=True)

    def prepare(self, phase: Phase) -> None:
        """Aim again when the cuboid is in the hand."""
        if phase.name == "carry":
            aim(self, is_aligned=True)


def poses_of(script: Script) -> tuple[Pose, Pose]:
    """Return the poses of the cuboid and of its goal."""
    return Pose.from_tquat(script.info["cuboid"]), Pose.from_tquat(script.info["goal"])


def aim(script: Script, *, is_aligned: bool = False) -> None:
    """Plan again how to set down the cuboid as it is in the hand, where it may have moved or turned."""
    cuboid, goal = poses_of(script)
    for arm in script.arms:
        tcp = Pose.from_tquat(arm.observation[TQUAT])
        joints = np.array(arm.observation[JOINTS])
        way = _way_down(arm, tcp.inverse() * cuboid, _goals(arm, cuboid, goal, is_aligned), joints)
        if way is not None:
            arm.plan = {**arm.plan, **way[1]}


def plan_carry(arm: ScriptedArm, cuboid: Pose, goal: Pose, *, is_aligned: bool = False) -> Plan | None:
    """Plan to grasp a cuboid across its short side from above and to set it down flat, with the least joint motion.

    Args:
        arm: The arm.
        cuboid: Pose of the cuboid in the base frame.
        goal: Where it belongs.
        is_aligned: Whether it should lie along the goal's axes, where the arm can do so.

    Returns:
        The poses `above`, `grasp`, `lifted`, `over`, `down` and `away`; None if nothing is feasible.
    """
    ways: list[tuple[float, Plan]] = []
    for lean in LEANS if arm.kinematics.dof < 6 else LEANS[:1]:
        for (turn,) in np.reshape(across(cuboid.matrix[:3, 1]), (2, 1)):
            grasp = plan_from_above(arm, cuboid, [[turn]], lean=float(lean))
            if grasp is None:
                continue
            in_tcp = Pose.from_tquat(grasp["grasp"]).inverse() * cuboid
            way = _way_down(arm, in_tcp, _goals(arm, cuboid, goal, is_aligned), arm.start)
            if way is not None:
                ways.append((way[0], {**grasp, **way[1]}))
    return min(ways, key=lambda way: way[0])[1] if ways else None


def _goals(arm: ScriptedArm, cuboid: Pose, goal: Pose, is_aligned: bool) -> list[Pose]:
    """Return flat poses at the goal that are worth a try."""
    yaw = cuboid.rpy[2]
    # A tool that leans can only be turned about the vertical together with the arm's base.
    swing = _azimuth(goal) - _azimuth(cuboid)
    if arm.kinematics.dof < 6:
        yaws = yaw + swing + TURNS
    elif is_aligned:
        yaws = goal.rpy[2] + np.array([0.0, np.pi])
    else:
        yaws = yaw + np.array([0.0, swing])
    return [Pose.from_rpy(goal.translation + [0.0, 0.0, DROP], (0.0, 0.0, yaw)) for yaw in yaws]


def _azimuth(pose: Pose) -> float:
    return float(np.arctan2(pose.translation[1], pose.translation[0]))


def _way_down(
    arm: ScriptedArm, cuboid_in_tcp: Pose, goals: list[Pose], start: NDArray[np.float64]
) -> tuple[float, Plan] | None:
    """Return the best way to set a cuboid down and what it costs; None if there is none."""
    ways: list[tuple[float, Plan]] = []
    for goal in goals:
        tool = goal * cuboid_in_tcp.inverse()
        down = reach(arm, tool, start, restarts=10)
        over = down and reach(arm, Pose((0.0, 0.0, CLEARANCE)) * tool, down[1])
        away = down and reach(arm, Pose.from_tquat(down[0]) * Pose((0.0, 0.0, -CLEARANCE)), down[1])
        if down and over and away:
            set_down = Pose.from_tquat(down[0]) * cuboid_in_tcp
            tilt = float(np.arccos(np.clip(set_down.matrix[2, 2], -1.0, 1.0)))
            cost = TILT_COST * tilt + float(np.abs(down[1] - start).max())
            ways.append((cost, {"over": over[0], "down": down[0], "away": away[0]}))
    return min(ways, key=lambda way: way[0]) if ways else None
