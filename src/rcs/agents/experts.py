"""The scripted experts of the built-in tasks."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rcs.agents.grasp import (
    CLEARANCE,
    CLOSE,
    CLOSING_TIME,
    REACH,
    Reach,
    are_empty,
    are_still,
    closing_yaw,
    plan_from_above,
    raised,
    reach,
    ways_from_above,
)
from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import JOINTS, TQUAT
from rcs.spatial import Pose

TOY_IN_TCP = (-0.015, 0.005)
"""Target of the toy's centre along the TCP's x and y [m], where a closing hand does not push it away."""
HAND_CLOSING_TIME = 0.6
"""Time for the fingers to close [s]; they meet the toy after 0.2 s."""
HELD = 0.10
"""Largest distance from the TCP to the centre of a toy in the hand [m]."""
TOY_TURNS = np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0])
"""Angles to try between the fingers and the direction away from the base, best first [rad]."""


def across(direction: NDArray[np.float64]) -> list[list[float]]:
    """Return both angles at which a symmetric gripper closes along a direction in the base frame, (3,)."""
    yaw = float(np.arctan2(-direction[0], direction[1]))
    return [[yaw, yaw + np.pi]]


class PickExpert(Script):
    """Picks the cuboid at `info["cuboid"]` across the shorter one of its level edges, `info["edges"]`."""

    task = "PickCuboid"
    needs = ("cuboid", "edges")
    phases = (
        *REACH,
        CLOSE,
        Phase("lift", "lifted", opening=0.0, risk=("slip", are_empty)),
        Phase("hold", "lifted", opening=0.0, risk=("slip", are_empty)),
    )

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan the grasp."""
        cuboid = Pose.from_tquat(self.info["cuboid"])
        yaw = float(closing_yaw(self.info["cuboid"], self.info["edges"]))
        return plan_from_above(arm, cuboid, [[yaw, yaw + np.pi]])


class LiftExpert(Script):
    """Lifts the bar at `info["bar_in_scene"]`, grasped at `info["grasp_offset"]` from its middle."""

    task = "LiftBar"
    needs = ("bar_in_scene", "grasp_offset")
    # Slow, so that both ends stay level.
    phases = (*REACH, CLOSE, Phase("lift", "lifted", 0.15, 0.0, risk=("slip", are_empty)))
    attempts = 1

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp across the bar's x axis, its short side; the first arm takes the end at larger y."""
        offset = float(self.info["grasp_offset"]) * (1.0 if arm is self.arms[0] else -1.0)
        end_in_scene = Pose.from_tquat(self.info["bar_in_scene"]) * Pose((0.0, offset, 0.0))
        end = arm.robot.base_in_scene.pose.inverse() * end_in_scene
        return plan_from_above(arm, end, across(end.matrix[:3, 0]))


def is_lost(script: Script) -> bool:
    """Return whether the toy is out of the hand."""
    offset = np.asarray(script.info["toy"])[:3] - script.arms[0].observation[TQUAT][:3]
    return float(np.sqrt(offset @ offset)) > HELD


def is_untouched(script: Script) -> bool:
    """Return whether the hand does not touch the toy."""
    return not script.info["is_touched"]


class ToyExpert(Script):
    """Picks the toy at `info["toy"]` in a power grasp, palm down, and brings it to where the arm started."""

    task = "PickToy"
    needs = ("toy",)
    phases = (
        *REACH,
        replace(CLOSE, until=lambda script: script.elapsed >= HAND_CLOSING_TIME, risk=("no_contact", is_untouched)),
        Phase("lift", "lifted", opening=0.0, risk=("slip", is_lost)),
        Phase("home", "home", opening=0.0, risk=("slip", is_lost)),
    )
    turn_speed = 1.0  # the toy hangs down
    arrived = (0.006, 0.05)  # the open hand is 4 cm wider than the toy

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp with the fingers pointing away from the base as directly as possible."""
        toy = Pose.from_tquat(self.info["toy"])
        azimuth = np.arctan2(toy.translation[1], toy.translation[0])
        return plan_from_above(arm, toy, [[azimuth + turn] for turn in TOY_TURNS], lift=0.10, in_tcp=TOY_IN_TCP)


DROP = 0.001
"""Height above its goal at which a cuboid is let go [m]."""
BLIND_DROP = 0.004
"""The same for a cuboid that nobody sees on its way [m]: it slips by up to 3 mm in the gripper when the arm swings
round, and an arm that presses it onto the table stops with a collision."""
WAIT = 2.0
"""Time after letting go at which a cuboid that does not lie where it belongs is picked up once more [s]."""
LEANS = np.deg2rad([0.0, -15.0, -30.0, 15.0, 30.0])
"""Angles by which an arm with fewer than six joints tries to lean its hand, positive away from its base [rad].

It has to lean at far places, and can set a cuboid down flat only if it leant as much when it grasped it.
"""
TURNS = np.deg2rad([0.0, 7.0, -7.0, 14.0, -14.0])
"""Turns of the cuboid that such an arm tries at the goal, besides that of its base [rad]."""
TILT_COST = 60.0
"""Largest motion of a joint that is as bad as an angle of 1 rad at which the cuboid is set down [rad]."""
GOOD = 5.0
"""Cost of a plan that is good enough: no more is sought [rad]."""
WAYPOINTS = 10
"""Poses on a straight line that are checked."""
JUMP = 0.5
"""Largest change of a joint between two of them [rad]: a turn of the tool by half a turn is 0.3 rad each."""
SLANT_COST = 20.0
"""The same of an angle of 1 rad between the jaws and the cuboid's sides [rad]."""
ASIDE = 0.008
"""How far the middle of the cuboid is from the TCP towards the moving jaw when its long side lies between the jaws [m]:
the other one would come down on it."""
CLEAR = 0.008
"""Distance by which a jaw that does not move leaves the cuboid before the fingers draw back [m]."""
RETREAT = 0.04
"""Distance by which the open fingers draw back from the cuboid [m]."""


def have_opened(script: Script) -> bool:
    """Return whether all grippers stand still after opening."""
    return script.elapsed > CLOSING_TIME and are_still(script)


IN_HAND = ("slip", are_empty)
CARRY = (
    *REACH,
    CLOSE,
    Phase("lift", "lifted", opening=0.0, risk=IN_HAND),
    Phase("carry", "over", 0.30, 0.0, risk=IN_HAND, turn_speed=1.5),  # faster, it would turn in the hand
    Phase("aim", "over", opening=0.0, until=lambda script: script.has_arrived() and script.is_still(), risk=IN_HAND),
    Phase("lower", "down", 0.10, 0.0, risk=IN_HAND),
    Phase("rest", "down", opening=0.0, until=REACH[-1].until, risk=IN_HAND),
    Phase("release", "down", until=have_opened),
    Phase("clear", "clear", 0.05),
    Phase("withdraw", "away", 0.10, turn_speed=0.3, risk=("dropped", lambda script: script.elapsed > WAIT)),
)


class PlaceExpert(Script):
    """Carries the cuboid at `info["cuboid"]` to `info["goal"]`, at the yaw that suits the arm best."""

    task = "Place"
    needs = ("cuboid", "goal")
    phases = CARRY
    is_aligned: ClassVar[bool] = False
    """Turn the cuboid along the goal's axes, if the arm can."""

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp and setting down."""
        return plan_carry(arm, *self._poses(), is_aligned=self.is_aligned)

    def prepare(self, phase: Phase) -> None:
        """Plan the setting down again for the cuboid in the hand, where it may have moved or turned."""
        if phase.name not in ("carry", "aim"):
            return
        cuboid, goal = self._poses()
        for arm in self.arms:
            tcp = Pose.from_tquat(arm.observation[TQUAT])
            joints = np.array(arm.observation[JOINTS])
            goals = _goals(arm, cuboid, goal, self.is_aligned and phase.name == "carry")
            way = _way_down(arm, tcp.inverse() * cuboid, goals, joints)
            if way is not None:
                arm.plan = {**arm.plan, **way[1]}

    def _poses(self) -> tuple[Pose, Pose]:
        """Return the poses of the cuboid, the right way up, and of its goal."""
        cuboid, goal = (Pose.from_tquat(self.info[key]) for key in ("cuboid", "goal"))
        if cuboid.matrix[2, 2] < 0.0:
            cuboid = cuboid * Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0))  # it is the same, upside down
        return cuboid, goal


class StackExpert(PlaceExpert):
    """Carries the cuboid at `info["cuboid"]` to `info["goal"]` and turns it along what is below, if the arm can."""

    task = "StackCuboid"
    is_aligned = True


class SetDownExpert(PlaceExpert):
    """Sets the cuboid in its gripper, at `info["cuboid"]`, down at `info["goal"]`, lets go of it and goes home.

    Only the start of the episode counts: nothing sees the cuboid on its way, on a real robot.
    """

    task = "PickCuboid"
    phases = (
        *(phase for phase in CARRY if phase.name in ("carry", "aim", "lower", "rest", "release", "clear")),
        Phase("withdraw", "away", 0.10, turn_speed=0.3),
        Phase("rise", "over"),
        Phase("home", "home", 0.25),
    )
    attempts = 1
    infeasible = "out_of_reach"

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan the setting down."""
        cuboid, goal = self._poses()
        in_tcp = Pose.from_tquat(arm.target).inverse() * cuboid
        way = _way_down(arm, in_tcp, _goals(arm, cuboid, goal, is_aligned=True, drop=BLIND_DROP), arm.start)
        return None if way is None else way[1]

    def prepare(self, phase: Phase) -> None:
        """Keep to the plan."""


def plan_carry(arm: ScriptedArm, cuboid: Pose, goal: Pose, *, is_aligned: bool = False) -> Plan | None:
    """Plan to grasp a cuboid from above and to set it down flat, with the least joint motion.

    A tool that need not lean grasps it across its short side.

    Args:
        arm: The arm.
        cuboid: Pose of the cuboid in the base frame.
        goal: Where it belongs.
        is_aligned: Whether it should lie along the goal's axes, where the arm can do so.

    Returns:
        The poses `above`, `grasp`, `lifted`, `over`, `down`, `clear` and `away`; None if nothing is feasible.
    """
    ways: list[tuple[float, Plan]] = []
    sides = [(1, 0.0)]
    if arm.kinematics.dof < 6:  # it leans, and one side may suit that better
        sides.append((0, ASIDE))
    for lean in LEANS if arm.kinematics.dof < 6 else LEANS[:1]:
        if any(cost < GOOD for cost, _ in ways):
            break
        for grasp, joints in (
            way
            for axis, aside in sides
            for way in ways_from_above(
                arm, cuboid, across(cuboid.matrix[:3, axis])[0], in_tcp=(0.0, aside), lean=float(lean)
            )
        ):
            in_tcp = Pose.from_tquat(grasp["grasp"]).inverse() * cuboid
            way = _way_down(arm, in_tcp, _goals(arm, cuboid, goal, is_aligned), joints)
            if way is not None:
                motion = float(np.abs(joints - arm.start).max())
                # Jaws at an angle would turn the cuboid; a moving jaw that points down would meet the table.
                rise = float(Pose.from_tquat(grasp["grasp"]).matrix[2, 1])
                slant = abs(rise) + max(0.0, -rise)
                ways.append((way[0] + motion + SLANT_COST * slant, {**grasp, **way[1]}))
    return min(ways, key=lambda way: way[0])[1] if ways else None


def _goals(arm: ScriptedArm, cuboid: Pose, goal: Pose, is_aligned: bool, drop: float = DROP) -> list[Pose]:
    """Return flat poses above the goal that are worth a try."""
    yaw = cuboid.rpy[2]
    # A tool that leans can only be turned about the vertical together with the arm's base.
    swing = _azimuth(goal) - _azimuth(cuboid)
    if arm.kinematics.dof < 6:
        yaws = yaw + swing + TURNS
    elif is_aligned:
        yaws = goal.rpy[2] + np.array([0.0, np.pi])
    else:
        yaws = yaw + np.array([0.0, swing])
    return [Pose.from_rpy(goal.translation + [0.0, 0.0, drop], (0.0, 0.0, yaw)) for yaw in yaws]


def _azimuth(pose: Pose) -> float:
    return float(np.arctan2(pose.translation[1], pose.translation[0]))


def _way_down(
    arm: ScriptedArm, cuboid_in_tcp: Pose, goals: list[Pose], start: NDArray[np.float64]
) -> tuple[float, Plan] | None:
    """Return the best way to set a cuboid down and what it costs; None if there is none."""
    ways: list[tuple[float, Plan]] = []
    gripper = arm.robot.gripper
    # A jaw that does not move touches the cuboid after opening; the moving one is towards y.
    aside = CLEAR if gripper is not None and len(gripper.joints) == 1 else 0.0
    for goal in goals:
        tool = goal * cuboid_in_tcp.inverse()
        over = _follow(arm, raised(tool, CLEARANCE), start)
        down = over and _follow(arm, tool, over[1])
        clear = down and reach(arm, Pose.from_tquat(down[0]) * Pose((0.0, -aside, 0.0)), down[1])
        away = clear and reach(arm, Pose.from_tquat(clear[0]) * Pose((0.0, 0.0, -RETREAT)), clear[1])
        if down and over and clear and away:
            at_rest = Pose.from_tquat(down[0])
            tilt = float(np.arccos(np.clip((at_rest * cuboid_in_tcp).matrix[2, 2], -1.0, 1.0)))
            turn = at_rest.angle_to(Pose.from_tquat(away[0]))  # the fingers would push the cuboid
            cost = TILT_COST * (tilt + turn) + float(np.abs(down[1] - start).max())
            ways.append((cost, {"over": over[0], "down": down[0], "clear": clear[0], "away": away[0]}))
    return min(ways, key=lambda way: way[0]) if ways else None


def _follow(arm: ScriptedArm, tool: Pose, start: NDArray[np.float64]) -> Reach | None:
    """Return how an arm reaches a pose on a straight line, without a jump to another branch; None if it cannot."""
    first, found = arm.kinematics.forward(start), (np.zeros(0), start)
    for share in np.linspace(0.0, 1.0, WAYPOINTS + 1)[1:]:
        joints = found[1]
        found = reach(arm, first.interpolate(tool, float(share)), joints)
        if found is None or np.abs(found[1] - joints).max() > JUMP:
            return None
    return found
