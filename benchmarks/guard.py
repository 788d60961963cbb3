"""The guard on colliding and on free motions, judged by MuJoCo's collision detection on densely sampled ways.

A scene with a table, three boxes and a thin plate, one arm and two. Every motion begins at random joints that keep the
margin, and is straight in joint space; its farthest joint goes 0.03 to 0.35 rad. A third have the plate (2 mm) in
mid-way of a link or finger, so that both ends may be free. The judge puts the model at points of the way and asks
`mj_collision`; it knows nothing of the guard's checker. The points are at most 2 mm apart for all shapes, or a quarter
of the least distance where that is more. Colliding are motions in contact at any point, free are those that keep the
margin and 2 mm for the sampling at all points; what lies between is neither. Grippers and the table are to keep 1 mm.

The guard sees each motion as an environment would give it: targets and measurements to `Guard.admit`.

Prints one JSON object per setup: `misses` (colliding motions that were admitted), `false_stops` (part of the free
motions that were refused), `p99_ms` and `p50_ms` (time of a check), `p99_cpu_ms` (the same without the time in which
other programs had the core), `colliding`, `free` (how many), `thin` (how many of the colliding ones had both ends
free).
"""

from __future__ import annotations

import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import get_context
from typing import Any

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import rcs
from rcs.envs import Guard
from rcs.errors import Refused
from rcs.sim import Scene
from rcs.tasks import Free

MARGIN, NEAR_MARGIN, SAMPLING = 0.01, 0.001, 0.002
BOXES = 3
WAY = 0.03, 0.35
"""Shortest and longest way of the joint that goes farthest [rad]: that of steps at 80 to 7 Hz at 2.5 rad/s."""
SEEN = 0.05
"""Distance up to which the judge measures [m]."""


@dataclass(kw_only=True)
class Options:
    """What to measure."""

    robot: tuple[str, ...] = ("fr3", "dual_fr3")
    """Robots, one after the other."""
    motions: int = 100_000
    """Number of colliding motions, and of free ones."""
    seed: int = 0
    """Of the motions."""
    workers: int = 1
    """Processes that share the motions; more disturb the times."""


class Obstacles(Free):
    """Boxes and a plate that the benchmark moves."""

    def furnish(self, scene: Scene) -> None:
        """Add them, as bodies without physics."""
        super().furnish(scene)
        sizes = [(0.05, 0.05, 0.05)] * BOXES + [(0.03, 0.03, 0.001)]
        for number, size in enumerate(sizes):
            body = scene.spec.worldbody.add_body(name=f"obstacle {number}", mocap=True, pos=[0.0, 3.0 + number, 0.0])
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size)


class Judge:
    """Says how near a robot comes to anything, by `mj_collision` alone."""

    def __init__(self, env: rcs.envs.Env) -> None:
        world, robots = env.scenario.world, list(env.robots.values())
        self.model = model = world.model
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = world.qpos
        joints = [model.joint(robot.prefix + name).id for robot in robots for name in robot.arm.joints]
        self.address = model.jnt_qposadr[joints]
        self.lower, self.upper = model.jnt_range[joints].T
        moving = np.zeros(model.nbody, np.bool_)
        moving[model.jnt_bodyid[joints]] = True
        for body in range(1, model.nbody):
            moving[body] |= moving[model.body_parentid[body]]
        self.moves = moving[model.geom_bodyid]
        names = [model.body(body).name for body in model.geom_bodyid]
        hand = np.array([any(name.startswith(robot.gripper_prefix) for robot in robots) for name in names])
        table = np.array([name == "table" for name in names])
        self.kept = np.where(hand[:, None] & table | table[:, None] & hand, NEAR_MARGIN, MARGIN)
        self.shapes = np.flatnonzero(self.moves & (model.geom_contype > 0))
        self._threshold = np.where(model.geom_contype > 0, SEEN, 0.0)

    def at(self, q: NDArray[np.float64]) -> tuple[bool, float]:
        """Return whether anything is in contact at joints, and the least distance beyond what is to be kept [m]."""
        model, data = self.model, self.data
        data.qpos[self.address] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if not data.ncon:
            return False, SEEN
        geoms, distance = data.contact.geom, data.contact.dist
        counts = self.moves[geoms].any(axis=1)
        if not counts.any():
            return False, SEEN
        kept = self.kept[geoms[:, 0], geoms[:, 1]]
        return bool((distance[counts] < 0.0).any()), float((distance - kept)[counts].min())

    def __enter__(self) -> Judge:
        """Have contacts told from a distance on."""
        self._margins = self.model.geom_margin.copy()
        self.model.geom_margin[:] = self._threshold
        return self

    def __exit__(self, *error: object) -> None:
        """Put the model back as it was."""
        self.model.geom_margin[:] = self._margins

    def way(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> tuple[bool, float]:
        """Return the same for the whole way."""
        centres = []
        for q in (start, (start + goal) / 2, goal):
            self.data.qpos[self.address] = q
            mujoco.mj_kinematics(self.model, self.data)
            turn = self.data.geom_xmat.reshape(-1, 3, 3)[self.shapes, :, :2]
            radius = self.model.geom_rbound[self.shapes]
            corners = [self.data.geom_xpos[self.shapes] + radius[:, None] * turn[:, :, i] for i in (0, 1)]
            centres.append(np.concatenate([self.data.geom_xpos[self.shapes], *corners]))
        length = sum(np.linalg.norm(b - a, axis=1) for a, b in pairwise(centres)).max()
        least = SEEN
        share = 0.0
        while True:
            touches, distance = self.at(start + share * (goal - start))
            least = min(least, distance)
            if touches or share == 1.0:
                return touches, least
            share = min(share + max(SAMPLING, 0.25 * distance) / (1.1 * length + 1e-9), 1.0)


def draw(random: np.random.Generator, judge: Judge) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Draw a motion and place the obstacles; the last says whether the plate is in its middle."""
    data = judge.data
    start = random.uniform(judge.lower, judge.upper)
    way = random.normal(size=len(start))
    goal = start + way / np.abs(way).max() * np.exp(random.uniform(*np.log(WAY)))
    goal = np.clip(goal, judge.lower, judge.upper)
    data.mocap_pos[:BOXES] = random.uniform((-0.3, -0.7, 0.05), (0.7, 0.7, 0.9), (BOXES, 3))
    data.mocap_pos[BOXES] = 3.0
    has_plate = random.random() < 1 / 3
    if has_plate:
        geom = random.choice(judge.shapes)
        places = []
        for q in (start, goal, (start + goal) / 2):
            data.qpos[judge.address] = q
            mujoco.mj_kinematics(judge.model, data)
            places.append(data.geom_xpos[geom].copy())
        data.mocap_pos[BOXES] = places[2]
        axis = places[1] - places[0]
        if np.linalg.norm(axis) > 0:
            mujoco.mju_quatZ2Vec(data.mocap_quat[BOXES], axis / np.linalg.norm(axis))
    return start, goal, has_plate


def measure(robot: str, motions: int, seed: int) -> dict[str, Any]:
    """Return the counts and times of one share of the motions."""
    guard = Guard(margin=MARGIN, near_margin=NEAR_MARGIN, touch=())
    env = rcs.make(Obstacles, robot=robot, stepping="sync", gates=[guard])
    env.reset(seed=seed)
    world, random, judge = env.scenario.world, np.random.default_rng(seed), Judge(env)
    names = list(env.robots) if len(env.robots) > 1 else [""]
    opening = np.ones(1, np.float32)

    def by_robot(q: NDArray[np.float64]) -> dict[str, Any]:
        return {
            name: {"joints": own, "gripper": opening} for name, own in zip(names, np.split(q, len(names)), strict=True)
        }

    counts = {"colliding": 0, "free": 0, "misses": 0, "stops": 0, "thin": 0}
    times: list[tuple[float, float]] = []
    while min(counts["colliding"], counts["free"]) < motions:
        with judge:
            start, goal, _ = draw(random, judge)
            if judge.at(start)[1] < 1e-3:  # begins too near
                continue
            touches, least = judge.way(start, goal)
            kind = "colliding" if touches else "free" if least >= SAMPLING else ""
            if not kind or counts[kind] >= motions:
                continue
            counts[kind] += 1
            counts["thin"] += touches and judge.at(goal)[1] > 0.0
        world.data.mocap_pos[:], world.data.mocap_quat[:] = judge.data.mocap_pos, judge.data.mocap_quat
        measured = by_robot(start)
        guard.reset(measured, ...)
        began = time.perf_counter(), time.thread_time()
        try:
            guard.admit(by_robot(goal), measured)
            is_admitted = True
        except Refused:
            is_admitted = False
        times.append((time.perf_counter() - began[0], time.thread_time() - began[1]))
        counts["misses"] += touches and is_admitted
        counts["stops"] += not touches and not is_admitted
    env.close()
    return {**counts, "times": times}


def main(options: Options) -> None:
    """Measure and print."""
    for robot in options.robot:
        shares = [options.motions // options.workers] * options.workers
        seeds = np.random.SeedSequence(options.seed).generate_state(options.workers).tolist()
        if options.workers == 1:
            found = [measure(robot, options.motions, seeds[0])]
        else:
            with ProcessPoolExecutor(options.workers, mp_context=get_context("fork")) as pool:
                found = list(pool.map(measure, [robot] * options.workers, shares, seeds))
        total = {key: sum(one[key] for one in found) for key in ("colliding", "free", "misses", "stops", "thin")}
        times = 1e3 * np.concatenate([one["times"] for one in found])
        figures = {
            "benchmark": "guard",
            "robot": robot,
            "misses": total["misses"],
            "false_stops": round(total["stops"] / total["free"], 5),
            "p99_ms": round(float(np.quantile(times[:, 0], 0.99)), 3),
            "p50_ms": round(float(np.median(times[:, 0])), 3),
            "p99_cpu_ms": round(float(np.quantile(times[:, 1], 0.99)), 3),
            **{key: total[key] for key in ("colliding", "free", "thin")},
        }
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
