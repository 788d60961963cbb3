"""Test planning on seeded problems for every robot, judged by MuJoCo's own collision detection.

Each problem has its own obstacles on and above the table, and a start and a goal that are drawn at random, free and
with each joint within 2 rad of home; in at least half of them the straight joint motion collides. A path that is found
is shortened, given times, and looked at at every millisecond: contacts (`mj_collision`, not the checker), and limits of
velocity, acceleration and jerk.

Prints one JSON object per robot: `solved_fraction`; `collisions`, paths with a contact; `median_ms`, of the planning
without the times; `detours`, problems whose straight motion collides; `over_limits`, samples beyond a limit.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass

import mujoco
import numpy as np
import tyro

import rcs
from rcs.errors import PlanningFailed
from rcs.kinematics import kinematics_of
from rcs.planning import CollisionChecker, JointLimits, Planner, TimedPath
from rcs.sim import RobotPlacement, Scene

ROBOTS = ("fr3", "xarm7", "ur5e", "so101")
END_EFFECTORS = {"xarm7": "robotiq_2f85"}
OBSTACLES = 6
SPREAD = 2.0
"""Largest distance of random joints from home [rad]."""
MARGIN = {"so101": 0.002}
"""Distance to keep [m], if not 5 mm: parts of the SO101 pass each other closer."""
ROUNDING = 1e-9


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: str = "all"
    """fr3, xarm7, ur5e, so101, or all."""
    problems: int = 50
    """Problems per robot."""
    planner: str = "RRTConnect"
    """Name of the planner."""
    time_limit: float = 5.0
    """Longest search [s]."""
    seed: int = 0
    """Random seed of the problems."""


def make_scene(robot: RobotPlacement, random: np.random.Generator) -> mujoco.MjModel:
    """Compile the robot on a table all around it, with boxes and posts."""
    scene = Scene.empty()
    scene.spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[2.0, 2.0, 0.02], pos=[0.0, 0.0, -0.02]
    )
    scene.add_robot(robot)
    reach = robot.arm.workspace_reach
    for i in range(OBSTACLES):
        angle, radius = random.uniform(-2.4, 2.4), random.uniform(0.35, 0.9) * reach
        x, y, _ = robot.base_in_scene.translation
        x, y = x + radius * np.cos(angle), y + radius * np.sin(angle)
        is_post = i % 2 == 0
        half = random.uniform([0.03, 0.03, 0.25], [0.05, 0.05, 0.45]) if is_post else random.uniform(0.05, 0.09, 3)
        half = half * reach
        z = half[2] if is_post else random.uniform(half[2], 0.7 * reach)
        scene.spec.worldbody.add_geom(
            name=f"obstacle {i}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[x, y, z], euler=[0, 0, angle]
        )
    return scene.compile()


class Judge:
    """Finds contacts of the robot with MuJoCo alone."""

    def __init__(self, model: mujoco.MjModel, joints: list[int], home: np.ndarray) -> None:
        """Note what moves with the joints, and where the robot always touches itself."""
        self.model, self.data = model, mujoco.MjData(model)
        self.joints = joints
        moving = np.zeros(model.nbody, bool)
        for body in range(1, model.nbody):
            owns = any(model.jnt_bodyid[j] == body for j in joints)
            moving[body] = owns or moving[model.body_parentid[body]]
        self.moving = moving[model.geom_bodyid]
        self.always = {pair for pair in self._contacts(home) if model.geom_bodyid[list(pair)].all()}  # 0 is the world

    def touches(self, q: np.ndarray) -> bool:
        """Return True if there is a contact, other than those of the robot with itself at home."""
        return bool(self._contacts(q) - self.always)

    def _contacts(self, q: np.ndarray) -> set[tuple[int, ...]]:
        self.data.qpos[self.model.jnt_qposadr[self.joints]] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        found = self.data.contact[: self.data.ncon]
        return {tuple(sorted(c.geom.tolist())) for c in found if c.dist < 0 and self.moving[c.geom].any()}


def count_over_limits(path: TimedPath, limits: JointLimits) -> int:
    """Return how many samples at 1 kHz are beyond a limit."""
    samples = path.sampled(1000.0)
    pairs = (
        (samples.velocities, limits.velocity),
        (samples.accelerations, limits.acceleration),
        (samples.jerks, limits.jerk),
    )
    return sum(int((np.abs(values) > limit + ROUNDING).any(axis=1).sum()) for values, limit in pairs)


def draw(
    checker: CollisionChecker, home: np.ndarray, margin: float, random: np.random.Generator, must_detour: bool
) -> np.ndarray:
    """Return a free start and a free goal, (2, dof); if asked for, with something on the straight line between.

    Joints are drawn up to `SPREAD` from home: what is folded the other way round, an arm whose joints turn twice cannot
    reach past itself and the table, even without obstacles.
    """
    lower, upper = np.maximum(checker.joint_lower, home - SPREAD), np.minimum(checker.joint_upper, home + SPREAD)
    while True:
        drawn = random.uniform(lower, upper, (64, checker.dof))
        free = drawn[checker.free_rows(drawn, 2 * margin)]
        for start, goal in zip(free[::2], free[1::2], strict=False):
            if not must_detour or checker.first_hit(start, goal) is not None:
                return np.array([start, goal])


def measure(name: str, options: Options) -> dict[str, object]:
    """Plan all problems of a robot."""
    with rcs.make(
        "Free", robot=name, **({"end_effector": END_EFFECTORS[name]} if name in END_EFFECTORS else {})
    ) as env:
        robot = next(iter(env.robots.values()))
    margin = MARGIN.get(name, 0.005)
    limits, home = JointLimits.of(robot.arm), np.array(robot.arm.home)
    solved = collisions = detours = over = 0
    times, timing, ways, durations = [], [], [], []
    problem = 0
    while problem < options.problems:
        random = np.random.default_rng([options.seed, problem])
        model = make_scene(robot, random)
        joints = [model.joint(robot.prefix + joint).id for joint in robot.arm.joints]
        checker = CollisionChecker(model, [joints])
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        planner = Planner(
            checker, limits, kinematics, margin=margin, planner=options.planner, time_limit=options.time_limit
        )
        start, goal = draw(checker, home, margin, random, must_detour=problem % 4 != 3)
        detours += checker.first_hit(start, goal) is not None
        problem += 1
        begin = time.perf_counter()
        try:
            path = planner.plan(start, goal, seed=problem)
        except PlanningFailed:
            times.append(time.perf_counter() - begin)
            continue
        times.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        timed = planner.time(path)
        timing.append(time.perf_counter() - begin)
        solved += 1
        ways.append(path.length / np.linalg.norm(goal - start))
        durations.append(timed.duration)
        judge = Judge(model, joints, home)
        over += count_over_limits(timed, limits)
        rows = timed.sampled(1000.0).positions
        collisions += any(judge.touches(q) for q in rows)
    return {
        "robot": name,
        "planner": options.planner,
        "problems": options.problems,
        "detours": detours,
        "solved_fraction": solved / options.problems,
        "collisions": collisions,
        "median_ms": round(1e3 * float(np.median(times)), 2),
        "p95_ms": round(1e3 * float(np.quantile(times, 0.95)), 1),
        "timing_median_ms": round(1e3 * float(np.median(timing)), 2),
        "over_limits": over,
        "length_over_straight": round(float(np.median(ways)), 2),
        "median_duration_s": round(float(np.median(durations)), 2),
    }


def main(options: Options) -> None:
    """Measure and print."""
    for name in ROBOTS if options.robot == "all" else (options.robot,):
        print(json.dumps(measure(name, options)), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
