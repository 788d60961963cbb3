"""The scripted experts of the built-in tasks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.agents.grasp import CLOSE, REACH, are_empty, closing_yaw, plan_from_above
from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.spaces import TQUAT
from rcs.spatial import Pose

TOY_IN_TCP = (-0.015, 0.005)
"""Target of the toy's centre along the TCP's x and y [m], where a closing hand does not push it away."""
HAND_CLOSING_TIME = 0.6
"""Time for the fingers to close [s]; they meet the toy after 0.2 s."""
HELD = 0.10
"""Largest distance from the TCP to the centre of a toy in the hand [m]."""
TURNS = np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0])
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
        base = arm.robot.base_in_scene
        end_in_scene = Pose.from_tquat(self.info["bar_in_scene"]) * Pose((0.0, offset, 0.0))
        end = Pose(base.translation, base.quaternion).inverse() * end_in_scene
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
        return plan_from_above(arm, toy, [[azimuth + turn] for turn in TURNS], lift=0.10, in_tcp=TOY_IN_TCP)
