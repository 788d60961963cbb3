"""An agent that plans: it picks the cuboid around everything that stands in the way, on another way in each episode."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.experts import PickExpert
from rcs.agents.grasp import CLEARANCE, closing_yaw, raised
from rcs.agents.script import Plan, Script, ScriptedArm
from rcs.envs.env import Env
from rcs.envs.planner_for import ScenePlanner, planner_for
from rcs.envs.spaces import JOINTS, Action
from rcs.errors import InvalidSetup, PlanningFailed
from rcs.kinematics import IkStatus, freedom_of
from rcs.planning.path import Path, TimedPath
from rcs.sim.scene import TABLE
from rcs.spatial import Pose
from rcs.tasks.pick_cuboid import CUBOID

SPEED = 0.6
"""Share of the arm's speed on the way."""
LIFT = 0.15
"""Height to lift above the grasp [m]."""
STRIDE = 0.03
"""Distance between the poses of a straight line that is checked [m]."""
NEAR, MARGINS = 0.0005, (0.01, 0.003)
"""Distances to keep from everything: near the object, where an open gripper passes it closely, and on the way, the
second where the first leaves no way [m]."""
LEANS = np.deg2rad((20.0, -20.0, 40.0, -40.0))
"""Angles by which the tool leans where it cannot grasp upright [rad]."""
WIDE = 0.85
"""Share of the gripper's stroke that the longer side of the cuboid may take, if it is to be grasped across that."""
TIME_LIMIT = 2.0
"""Longest search for a part of a way [s]: most take milliseconds, and those that are this long seldom end."""
JUMP = 0.4
"""Largest change of a joint between two poses of a straight line [rad]; more is another branch."""
ROOTS = 6
"""Solutions of inverse kinematics among which one is drawn."""
WANDER = 0.35
"""Spread of the point that the way leads by, around the middle between start and pre-grasp [rad]."""
TRIES = 12
"""Points to lead by that are tried; without a free one, the way is direct."""

Rows = NDArray[np.float64]


def has_come(script: Script) -> bool:
    """Return whether the planned way is over and the arm is at its end."""
    assert isinstance(script, PickPlanner)
    is_over = script.phase != script.phases[0].name or script.elapsed >= script.way.duration
    return is_over and script.has_arrived()


class PickPlanner(PickExpert):
    """Picks the cuboid of PickCuboid past obstacles and distractors, with what the simulation knows of them.

    It is `PickExpert` but for the grasp and the way to the pre-grasp above it, which are planned. The straight lines
    down to the grasp and up again are checked, the latter with the cuboid in the hand. Where no upright grasp across
    the shorter side has a way, the tool leans, or grasps across the longer side. Ways differ from episode to episode:
    which arm posture grasps, and a random point to lead by. The same episode has the same way.
    """

    phases = (replace(PickExpert.phases[0], until=has_come), *PickExpert.phases[1:])
    infeasible = "plan"

    def __init__(self, env: Env) -> None:
        """Prepare for an environment.

        Args:
            env: A simulated environment with one robot, and the task PickCuboid.

        Raises:
            InvalidSetup: There are several robots.
            WrongOrder: The environment is not simulated.
        """
        if len(env.robots) != 1:
            raise InvalidSetup(f"PickPlanner moves one robot, there are {len(env.robots)}: {', '.join(env.robots)}.")
        super().__init__(env)
        self._env = env
        # Without a pull to other joints: the straight lines are checked for those that lead the TCP there directly.
        arm = self.arms[0]
        arm.writer = ActionWriter(env.setup, env.action_space, arm.kinematics)  # pyright: ignore[reportArgumentType]
        self.way: TimedPath
        """The way to the pre-grasp."""

    def plan(self, arm: ScriptedArm) -> Plan | None:
        """Plan a grasp, and the way to it from where the arm is."""
        # Made anew for each episode, since sizes may vary.
        self._planner = planner_for(self._env, margin=MARGINS[0], time_limit=TIME_LIMIT, speed=SPEED)
        self._carrying = planner_for(self._env)
        self._carrying.checker.allow(CUBOID, TABLE)  # it touches the table when it is lifted
        checker, kinematics = self._planner.checker, arm.kinematics
        start = np.clip(arm.observation[JOINTS], checker.joint_lower, checker.joint_upper)
        key = np.concatenate([np.round(self.info["cuboid"], 6), np.round(start, 6)])
        random = np.random.default_rng(zlib.crc32(key.tobytes()))
        for tools in self._grasps(arm):
            ways = self._lines(arm, tools, start)
            nearest = sorted(ways, key=lambda way: float(np.linalg.norm(way[0][0] - start)))[:ROOTS]
            for self._planner.margin in MARGINS:
                for i in random.permutation(len(nearest)):
                    descent, lifted = nearest[i]
                    try:
                        self.way = self._planner.time(self._way(start, descent[0], random))
                    except PlanningFailed:
                        continue
                    ends = {"above": descent[0], "grasp": descent[-1], "lifted": lifted[-1]}
                    return {name: kinematics.forward(joints).tquat for name, joints in ends.items()}
        return None

    def _step(self, arm: ScriptedArm) -> Action:
        """Return the next action, on the planned way to the pre-grasp."""
        if self.phase != self.phases[0].name:
            return super()._step(arm)
        now = self.elapsed + self._period
        joints = self.way.at(now).positions[0]
        is_over = now >= self.way.duration
        arm.target = arm.plan["above"] if is_over else arm.kinematics.forward(joints).tquat
        return arm.writer.write_joints(joints, self.phases[0].opening)

    def _grasps(self, arm: ScriptedArm) -> Iterator[list[Pose]]:
        """Yield groups of TCP poses that grasp the cuboid, best first."""
        cuboid, edges = Pose.from_tquat(self.info["cuboid"]), self.info["edges"]
        sides = [float(closing_yaw(self.info["cuboid"], edges))]
        level = np.abs(cuboid.matrix[2, :3]) < 0.5
        gripper = arm.robot.gripper
        if gripper is not None and np.asarray(edges)[level].max() < WIDE * gripper.max_width:
            sides.append(sides[0] + np.pi / 2)
        for lean in ([0.0], LEANS[:2], LEANS[2:]):
            for side in sides:
                yield [_tool(arm, cuboid, turn, tilt) for turn in (side, side + np.pi) for tilt in lean]

    def _way(self, start: Rows, goal: Rows, random: np.random.Generator) -> Path:
        """Return a way to the pre-grasp, by a random point if there is a free one."""
        seed = int(random.integers(2**31))
        checker = self._planner.checker
        for _ in range(TRIES):
            middle = 0.5 * (start + goal) + random.normal(0.0, WANDER, len(start))
            middle = np.clip(middle, checker.joint_lower, checker.joint_upper)
            if checker.is_free(middle, self._planner.margin):
                try:
                    there = self._planner.plan(start, middle, seed=seed).waypoints
                    return Path(np.vstack([there, self._planner.plan(middle, goal, seed=seed).waypoints[1:]]))
                except PlanningFailed:
                    break
        return self._planner.plan(start, goal, seed=seed)

    def _lines(self, arm: ScriptedArm, tools: Sequence[Pose], start: Rows) -> list[tuple[Rows, Rows]]:
        """Return descents from pre-grasps, and lifts from their ends, that touch nothing; rows of joints."""
        cuboid = Pose.from_tquat(self.info["cuboid"])
        ways: list[tuple[Rows, Rows]] = []
        for tool in tools:
            try:
                roots = self._planner.goals(raised(tool, CLEARANCE), start=start)
            except PlanningFailed:
                continue
            for root in roots[: 4 * ROOTS]:
                if not self._planner.checker.is_free(root, MARGINS[-1]):
                    continue
                descent = _line(arm, tool, root, CLEARANCE, 0.0, self._planner)
                if descent is None:
                    continue
                self._carrying.attach(CUBOID, arm.kinematics.forward(descent[-1]).inverse() * cuboid)
                lifted = _line(arm, tool, descent[-1], 0.0, LIFT, self._carrying)
                if lifted is not None:
                    ways.append((descent, lifted))
        return ways


def _tool(arm: ScriptedArm, cuboid: Pose, turn: float, lean: float) -> Pose:
    """Return a TCP pose that points down, but for an angle by which it leans [rad]."""
    down = Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, turn))
    if arm.kinematics.dof < 6:  # it leans in the plane of the arm, or not at all
        x, y, _ = cuboid.translation
        axis = np.array([-y, x, 0.0]) / np.hypot(x, y)
        leaning = Pose.from_rotvec((0.0, 0.0, 0.0), lean * axis) * down
    else:  # about the axis along which its jaws close
        leaning = down * Pose.from_rotvec((0.0, 0.0, 0.0), np.array([0.0, lean, 0.0]))
    return Pose(cuboid.translation, leaning.quaternion)


def _line(arm: ScriptedArm, tool: Pose, joints: Rows, begin: float, end: float, scene: ScenePlanner) -> Rows | None:
    """Return joints that lead the TCP straight from height to height above the grasp; None if it is not free."""
    rows, options = [joints], freedom_of(arm.kinematics)
    count = max(int(np.ceil(abs(end - begin) / STRIDE)), 1)
    for height in np.linspace(begin, end, count + 1)[1:]:
        result = arm.kinematics.inverse(raised(tool, float(height)), rows[-1], options)
        if result.status != IkStatus.ok or np.abs(result.joints - rows[-1]).max() > JUMP:
            return None
        rows.append(result.joints)
    line = np.array(rows)
    hits, _, _ = scene.checker.first_hit_rows(line[:-1], line[1:], 0.002, 0.02, NEAR)
    return line if np.isinf(hits).all() else None
