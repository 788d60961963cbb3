"""The scripted expert that pushes a block onto a goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.agents.grasp import plan_from_above
from rcs.agents.script import Phase, Plan, Script, ScriptedArm
from rcs.envs.control_layers import GRASP
from rcs.envs.env import Env
from rcs.envs.spaces import TQUAT, Action, Observation
from rcs.kinematics import load
from rcs.robots import GripperDescription, HandDescription
from rcs.spatial import Pose

BEHIND = 0.012
"""Distance from the block to where the tool comes down [m]."""
LOW = 0.006
"""Height of the tool's tip above the table [m]."""
LEAD, LEAD_AT_REST = 0.03, 0.005
"""Distance from the tool to its target at which the target waits [m]: in motion, and where steps end at rest."""
STRAIGHT = 0.03
"""Last part of the way, on which the direction no longer changes [m]: it would swing with every millimetre beside."""
NEAR = 0.004
"""Distance from the goal at which the block has arrived [m]."""
BESIDE = np.deg2rad(60.0)
"""Angle at the block between the tool and the way to the goal at which the block slips past the tool."""
SETTLING_TIME = 1.5
"""Time for the block to lie still and be judged [s]."""
TIP_LENGTH = 0.03
"""Length of the tool's tip [m]: about the height of the block."""


def has_pushed(script: Script) -> bool:
    """Return whether the block reaches the goal when the tool arrives where it is sent."""
    assert isinstance(script, PushExpert)
    return script.remaining <= NEAR


def is_beside(script: Script) -> bool:
    """Return whether the block slips past the tool."""
    assert isinstance(script, PushExpert)
    return script.bearing > BESIDE and script.remaining > NEAR


class PushExpert(Script):
    """Pushes the block at `info["block"]` to `info["goal"]`, with the end effector closed and pointing down.

    The tool comes down behind the block, one of its sides towards the goal, and from then on goes in the direction from
    the block's middle to the goal, wherever that is by then. If the block slips past it, or ends beside the goal, the
    expert starts again.
    """

    task = "Push"
    needs = ("block", "goal", "edges")
    phases = (
        Phase("approach", "above", 0.45, 0.0),
        Phase("descend", "behind", opening=0.0),
        Phase("push", "ahead", 0.12, 0.0, until=has_pushed, risk=("slip", is_beside)),
        Phase(
            "rest",
            opening=0.0,
            until=lambda script: script.elapsed >= SETTLING_TIME,
            risk=("slip", lambda script: not script.info["success"]),
            is_judged_at_end=True,
        ),
    )
    attempts = 4

    def __init__(self, env: Env) -> None:
        """Measure the tool."""
        super().__init__(env)
        effector = self.arms[0].robot.end_effector
        self.tip = Tip(middle=(0.0, 0.0, 0.0), half=(0.01, 0.01)) if effector is None else Tip.of(effector)
        self.remaining = self.bearing = 0.0
        """Distance that the block still has to go [m]; angle at the block between tool and way, 0 behind it [rad]."""
        self._lead = LEAD_AT_REST if env.setup.stepping == "sync" else LEAD
        self._way = np.zeros(2)
        """Direction to the goal."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Steer towards the goal, and continue."""
        if self.phase == "push":
            self._steer(self.arms[0], observation, info)
        return super().act(observation, info)

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan how the tool comes down behind the block, with a side of it towards the goal."""
        block, goal = self.info["block"], self.info["goal"]
        way = self._way = _direction(block, goal)
        back = 0.5 * float(np.hypot(*self.info["edges"][:2])) + self.tip.radius + BEHIND
        wanted = np.array([*(block[:2] - back * way), goal[2] + LOW])
        azimuth = float(np.arctan2(way[1], way[0]))
        turns = [[azimuth + k * np.pi / 2 for k in range(4)]]
        if arm.robot.hand is not None:  # a fist pushes with the backs of its fingers, the only side that is flat
            turns = [[azimuth], [azimuth + 0.5, azimuth - 0.5], *turns]
        place, plan = wanted + [0.0, 0.0, self.tip.middle[2]], None
        for _ in range(3):  # the tool of an arm with few joints leans, which shifts its tip
            plan = plan_from_above(arm, Pose(place), turns, lift=0.0, in_tcp=self.tip.middle[:2])
            if plan is None:
                return None
            place = place + wanted - self.tip.place(plan["grasp"])
        return plan and {"above": plan["above"], "behind": plan["grasp"]}

    def _steer(self, arm: ScriptedArm, observation: Observation, info: Mapping[str, Any]) -> None:
        """Set where the tool goes next: ahead, unless the arm has to catch up."""
        block, goal, tcp = info["block"], info["goal"], observation[TQUAT]
        if np.hypot(*(goal - block)[:2]) > STRAIGHT:
            self._way = _direction(block, goal)
        way = self._way
        now = self.tip.place(tcp)
        # Where the tip will be once the arm has caught up with its target.
        lead = arm.target[:3] - tcp[:3]
        offset = now[:2] + lead[:2] - block[:2]
        self.bearing = float(np.arccos(np.clip(-(offset @ way) / np.sqrt(offset @ offset), -1.0, 1.0)))
        self.remaining = float(((goal - block)[:2] - lead[:2]) @ way)
        ahead = arm.target.copy()
        if float(np.sqrt(lead @ lead)) < self._lead:
            ahead[:2] += way * max(self.remaining, 0.0)
        ahead[2] = goal[2] + LOW + tcp[2] - now[2]
        arm.plan = {**arm.plan, "ahead": ahead}


def _direction(block: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction from block to goal on the table, (2,)."""
    way = goal[:2] - block[:2]
    return way / max(float(np.sqrt(way @ way)), 1e-9)


@dataclass(frozen=True, kw_only=True)
class Tip:
    """The box around the tip of a closed gripper or hand, in the TCP's frame."""

    middle: tuple[float, float, float]
    """Middle of the face at its end [m]."""
    half: tuple[float, float]
    """Half its extents along x and y [m]."""

    @staticmethod
    def of(effector: GripperDescription | HandDescription) -> Tip:
        """Measure the shapes that collide, of a gripper closed on nothing or a hand in a power grasp."""
        model = load(effector).compile()
        data = mujoco.MjData(model)
        for name, value in zip(effector.joints, _closed(effector), strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        tcp = data.site(effector.tcp_site)
        solid = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
        corners = np.concatenate([_corners(model, data, int(geom)) for geom in solid])
        corners = (corners - tcp.xpos) @ tcp.xmat.reshape(3, 3)
        end = corners[:, 2].max()
        sides = corners[corners[:, 2] > end - TIP_LENGTH, :2]
        low, high = sides.min(axis=0), sides.max(axis=0)
        x, y = ((low + high) / 2).tolist()
        half_x, half_y = ((high - low) / 2).tolist()
        return Tip(middle=(x, y, float(end)), half=(half_x, half_y))

    @property
    def radius(self) -> float:
        """Radius of the circle around it [m]."""
        return float(np.hypot(*self.half))

    def place(self, tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the middle for a pose of the TCP (7,), in the same frame: x, y, and its lowest z [m], (3,)."""
        rotation = Pose.from_tquat(tcp).matrix[:3, :3]
        middle = tcp[:3] + rotation @ np.array(self.middle)
        middle[2] -= np.abs(rotation[2, :2]) @ np.array(self.half)
        return middle


def _closed(effector: GripperDescription | HandDescription) -> NDArray[np.float64]:
    if isinstance(effector, GripperDescription):
        return np.array(effector.joint_closed)
    low, high = np.array(effector.joint_lower), np.array(effector.joint_upper)
    return low + np.array(effector.grasps[GRASP]) * (high - low)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
    """Return the corners of the box around a geom, (8, 3) [m]."""
    center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    return data.geom_xpos[geom] + (center + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T
