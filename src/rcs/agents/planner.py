"""An agent that plans: it picks the cuboid around everything that stands in the way, on another way in each episode."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import ActionWriter
from rcs.agents.agent import Agent
from rcs.agents.grasp import BARELY_CLOSED, CLEARANCE, CLOSING_TIME, EMPTY, SETTLING_TIME, STILL, closing_yaw, raised
from rcs.envs.env import Env
from rcs.envs.planner_for import ScenePlanner, planner_for
from rcs.envs.spaces import GRIPPER, JOINTS, Action, Observation
from rcs.errors import InvalidSetup, PlanningFailed, WrongOrder
from rcs.kinematics import IkStatus, Kinematics, freedom_of
from rcs.planning.path import Path, TimedPath
from rcs.planning.timing import JointLimits, time_path
from rcs.sim.scene import TABLE
from rcs.spatial import Pose
from rcs.tasks.pick_cuboid import CUBOID

SPEED, SLOWLY = 0.45, 0.2
"""Shares of the arm's speed on the way, and near the object."""
EFFORT = 0.5
"""Share of its acceleration and jerk."""
LIFT = 0.15
"""Height to lift above the grasp [m]."""
STRIDE = 0.03
"""Distance between the poses of a straight descent [m]."""
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
"""Largest change of a joint between two poses of a descent [rad]; more is another branch."""
ROOTS = 6
"""Solutions of inverse kinematics among which one is drawn."""
WANDER = 0.35
"""Spread of the point that the way leads by, around the middle between start and pre-grasp [rad]."""
TRIES = 12
"""Points to lead by that are tried; without a free one, the way is direct."""
ARRIVED = 0.01
"""Distance of each joint from its goal at which a motion is over [rad]."""
PATIENCE = 2.0
"""Longest time to wait for that [s]."""

Rows = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a pick: a motion, and when it is over."""

    name: str
    opening: float
    motion: TimedPath | None
    """None to stand still."""
    until: Callable[[PickPlanner], bool]


class PickPlanner(Agent):
    """Picks the cuboid of PickCuboid past obstacles and distractors, with what the simulation knows of them.

    It plans to a pre-grasp above the cuboid, descends in a straight line, grasps and lifts, which is checked with the
    cuboid in the hand. Where no upright grasp across the shorter side has a way, the tool leans, or grasps across the
    longer side. Ways differ from episode to
    episode: which arm posture grasps, and a random point to lead by. The same episode has the same way. After a grasp
    that missed, it tries once more.
    """

    def __init__(self, env: Env, *, wander: float = WANDER, planner: str = "RRTConnect") -> None:
        """Prepare for an environment.

        Args:
            env: A simulated environment with one robot, and the task PickCuboid.
            wander: How far ways lead astray [rad]; 0 for the shortest that are found.
            planner: Name of the planner.

        Raises:
            InvalidSetup: There are several robots.
            WrongOrder: The environment is not simulated.
        """
        if len(env.robots) != 1:
            raise InvalidSetup(f"PickPlanner moves one robot, there are {len(env.robots)}: {', '.join(env.robots)}.")
        self._robot = next(iter(env.robots.values()))
        self._planner: ScenePlanner = planner_for(env, margin=MARGINS[0], planner=planner, time_limit=TIME_LIMIT)
        # What is lifted off the table touches it at first.
        self._carrying: ScenePlanner = planner_for(env)
        self._carrying.checker.allow(CUBOID, TABLE)
        assert self._planner.kinematics is not None
        self._kinematics: Kinematics = self._planner.kinematics
        self._writer = ActionWriter(env.setup, env.action_space, self._kinematics, preferred=self._robot.arm.home)  # pyright: ignore[reportArgumentType]
        self._planner.limits, self._slowly = (
            slower(JointLimits.of(self._robot.arm), speed) for speed in (SPEED, SLOWLY)
        )
        self._wander = wander
        self._period = 1.0 / env.setup.frequency
        self._parts: Sequence[Part] = ()
        self._at = self._attempt = 0
        self._began = self._now = 0.0
        self._goal = np.zeros(0)
        self._opening = self._last_opening = 1.0
        self._joints = np.zeros(0)
        self._failure: str | None = None

    @property
    def failure(self) -> str | None:
        """`plan`: there is no way; `no_contact`: the gripper closed on nothing."""
        return self._failure

    @property
    def elapsed(self) -> float:
        """Time since the present part began [s]."""
        return self._now - self._began

    def has_arrived(self) -> bool:
        """Return whether the motion of the present part is over and the arm is at its end."""
        motion = self._parts[self._at].motion
        assert motion is not None
        late = self.elapsed - motion.duration
        return late >= 0.0 and (bool(np.abs(self._joints - self._goal).max() < ARRIVED) or late > PATIENCE)

    def has_closed(self) -> bool:
        """Return whether the gripper stands still, closed on something or on nothing."""
        is_still = abs(self._opening - self._last_opening) < STILL * self._period
        return self.elapsed > CLOSING_TIME and self._opening < BARELY_CLOSED and is_still

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Plan a new episode.

        Raises:
            WrongOrder: The environment has another task.
        """
        if missing := [key for key in ("cuboid", "edges") if key not in info]:
            raise WrongOrder(f"PickPlanner needs info[{missing[0]!r}]; use it in the task PickCuboid.")
        self._writer.reset(observation)
        self._joints = self._goal = np.array(observation[JOINTS])
        self._opening = self._last_opening = float(observation[GRIPPER][0])
        self._failure, self._attempt, self._now = None, 0, float(info["time"])
        self._begin(info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Go on."""
        self._writer.follow(info)
        self._now = float(info["time"])
        self._joints = np.array(observation[JOINTS])
        self._last_opening, self._opening = self._opening, float(observation[GRIPPER][0])
        part = self._parts[self._at]
        if part.until(self):
            if part.name == "close" and self._opening < EMPTY:
                self._failure = "no_contact"
                if self._attempt < 2:
                    self._begin(info)
            elif self._at + 1 < len(self._parts):
                self._at += 1
            self._began = self._now
            part = self._parts[self._at]
        if part.motion is not None:
            self._goal = part.motion.at(self.elapsed + self._period).positions[0]
        return self._writer.write_joints(self._goal, part.opening)

    def _begin(self, info: Mapping[str, Any]) -> None:
        """Plan an attempt from where the arm is."""
        self._attempt += 1
        self._began, self._at = self._now, 0
        key = np.concatenate([np.round(info["cuboid"], 6), np.round(self._joints, 6)])
        random = np.random.default_rng(zlib.crc32(key.tobytes()) + self._attempt)
        try:
            self._parts = self._plan(info, random)
        except PlanningFailed:
            self._failure = "plan"
            self._parts = [Part("given up", 1.0, None, lambda _: False)]

    def _plan(self, info: Mapping[str, Any], random: np.random.Generator) -> list[Part]:
        self._planner.look()
        start = self._writer.joints
        back: list[Part] = []
        if self._attempt > 1:  # out of the grasp first, on the way that led in
            up = self._descent[::-1]
            back = [Part("retreat", 1.0, self._straight(up), PickPlanner.has_arrived)]
            start = up[-1]
        cuboid = Pose.from_tquat(info["cuboid"])
        for tools in self._grasps(cuboid, info):
            ways = self._ways(cuboid, tools, start)
            nearest = sorted(ways, key=lambda way: float(np.linalg.norm(way[0][0] - start)))[:ROOTS]
            for margin in MARGINS:
                self._planner.margin = margin
                for i in random.permutation(len(nearest)):
                    self._descent, lifted = nearest[i]
                    try:
                        way = self._way(start, self._descent[0], random)
                    except PlanningFailed:
                        continue
                    return [*back, *self._parts_of(way, self._descent, lifted)]
        raise PlanningFailed("No grasp has a free way there, a free descent and a free lift.", reason="goal")

    def _parts_of(self, way: Path, descent: Rows, lifted: Rows) -> list[Part]:
        return [
            Part("reach", 1.0, self._planner.time(way), PickPlanner.has_arrived),
            Part("descend", 1.0, self._straight(descent), PickPlanner.has_arrived),
            Part("settle", 1.0, None, lambda agent: agent.elapsed >= SETTLING_TIME),
            Part("close", 0.0, None, PickPlanner.has_closed),
            Part("lift", 0.0, self._straight(lifted), lambda _: False),
        ]

    def _grasps(self, cuboid: Pose, info: Mapping[str, Any]) -> Iterator[list[Pose]]:
        """Yield groups of TCP poses that grasp the cuboid, best first."""
        yaw = float(closing_yaw(info["cuboid"], info["edges"]))
        sides = [yaw]
        level = np.abs(cuboid.matrix[2, :3]) < 0.5
        gripper = self._robot.gripper
        if gripper is not None and np.asarray(info["edges"])[level].max() < WIDE * gripper.max_width:
            sides.append(yaw + np.pi / 2)
        for lean in ([0.0], LEANS[:2], LEANS[2:]):
            for side in sides:
                yield [self._tool(cuboid, turn, tilt) for turn in (side, side + np.pi) for tilt in lean]

    def _tool(self, cuboid: Pose, turn: float, lean: float) -> Pose:
        """Return a TCP pose that points down, but for an angle by which it leans [rad]."""
        down = Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, turn))
        if self._kinematics.dof < 6:  # it leans in the plane of the arm, or not at all
            x, y, _ = cuboid.translation
            axis = np.array([-y, x, 0.0]) / np.hypot(x, y)
            leaning = Pose.from_rotvec((0.0, 0.0, 0.0), lean * axis) * down
        else:  # about the axis along which its jaws close
            leaning = down * Pose.from_rotvec((0.0, 0.0, 0.0), np.array([0.0, lean, 0.0]))
        return Pose(cuboid.translation, leaning.quaternion)

    def _way(self, start: Rows, goal: Rows, random: np.random.Generator) -> Path:
        """Return a way to the pre-grasp, by a random point if there is a free one."""
        seed = int(random.integers(2**31))
        lower, upper = self._planner.checker.joint_lower, self._planner.checker.joint_upper
        for _ in range(TRIES if self._wander else 0):
            middle = 0.5 * (start + goal) + random.normal(0.0, self._wander, len(start))
            middle = np.clip(middle, lower, upper)
            if self._planner.checker.is_free(middle, self._planner.margin):
                try:
                    there = self._planner.plan(start, middle, seed=seed).waypoints
                    return Path(np.vstack([there, self._planner.plan(middle, goal, seed=seed).waypoints[1:]]))
                except PlanningFailed:
                    break
        return self._planner.plan(start, goal, seed=seed)

    def _ways(self, cuboid: Pose, tools: Sequence[Pose], start: Rows) -> list[tuple[Rows, Rows]]:
        """Return descents from pre-grasps, and lifts from their ends, that touch nothing; rows of joints."""
        ways: list[tuple[Rows, Rows]] = []
        for tool in tools:
            try:
                roots = self._planner.goals(raised(tool, CLEARANCE), start=start)
            except PlanningFailed:
                continue
            for root in roots[: 4 * ROOTS]:
                if not self._planner.checker.is_free(root, MARGINS[-1]):
                    continue
                descent = self._line(tool, root, CLEARANCE, 0.0, self._planner)
                if descent is None:
                    continue
                self._carrying.attach(CUBOID, self._kinematics.forward(descent[-1]).inverse() * cuboid)
                lifted = self._line(tool, descent[-1], 0.0, LIFT, self._carrying)
                if lifted is not None:
                    ways.append((descent, lifted))
        return ways

    def _line(self, tool: Pose, joints: Rows, begin: float, end: float, scene: ScenePlanner) -> Rows | None:
        """Return joints that lead the TCP straight from height to height above the grasp; None if it is not free."""
        rows = [joints]
        count = max(int(np.ceil(abs(end - begin) / STRIDE)), 1)
        for height in np.linspace(begin, end, count + 1)[1:]:
            result = self._kinematics.inverse(raised(tool, float(height)), rows[-1], freedom_of(self._kinematics))
            if result.status != IkStatus.ok or np.abs(result.joints - rows[-1]).max() > JUMP:
                return None
            rows.append(result.joints)
        line = np.array(rows)
        hits, _, _ = scene.checker.first_hit_rows(line[:-1], line[1:], 0.002, 0.02, NEAR)
        return line if np.isinf(hits).all() else None

    def _straight(self, rows: Rows) -> TimedPath:
        return time_path(Path(rows), self._slowly, bend=0.05)


def slower(limits: JointLimits, speed: float) -> JointLimits:
    """Return limits for a share of the speed, at a share of acceleration and jerk that does not depend on it."""
    return JointLimits(
        velocity=speed * limits.velocity, acceleration=EFFORT * limits.acceleration, jerk=EFFORT * limits.jerk
    )
