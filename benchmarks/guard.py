"""Test the guard on colliding and free motions, judged by MuJoCo's collision detection along the whole path.

A scene with a table, three boxes and a thin plate, one arm and two. Every motion begins at random joints that keep the
margin, and is straight in joint space; its farthest joint goes 0.03 to 0.35 rad. Half have the plate (2 mm) in
mid-way of a link or finger, so that both ends may be free, and a third have a box ahead of one.

The judge puts the model at points of the way and asks `mj_collision`; it knows nothing of the guard's checker. From
each point it goes as far as no pair can have used up the distance that MuJoCo gives (or 2 mm, where that is more):
what a pair approaches at most is the sum, over the joints between the two, of the joint's way times a lever arm.
Colliding are motions in contact at any point, free are those that keep the margin and 2 mm at all points, and
therefore the margin everywhere; what lies between is neither. Grippers and the table are to keep 1 mm.

The guard sees each motion as an environment would give it: targets and measurements to `Guard.admit`.

Prints one JSON object per setup: `misses` (colliding motions that were admitted), `false_stops` (part of
the free motions that were refused), `p99_ms` and `p50_ms` (time of a check), `p99_cpu_ms` (the same without the time
in which other programs had the core), `colliding`, `free` (how many), `thin` (how many of the colliding ones had both
ends free).
"""

from __future__ import annotations

import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
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
    """Options of the benchmark."""

    robot: tuple[str, ...] = ("fr3", "dual_fr3")
    """Robots, one after the other."""
    motions: int = 100_000
    """Number of colliding motions, and of free ones."""
    seed: int = 0
    """Random seed of the motions."""
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
        world, robots = env.simulation.world, list(env.robots.values())
        self.model = model = world.model
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = world.qpos
        joints = np.array([model.joint(robot.prefix + name).id for robot in robots for name in robot.arm.joints])
        self.joints, self.address = joints, model.jnt_qposadr[joints]
        self.lower, self.upper = model.jnt_range[joints].T
        carries = np.zeros((model.nbody, len(joints)))
        carries[model.jnt_bodyid[joints], np.arange(len(joints))] = 1.0
        for body in range(1, model.nbody):
            carries[body] = np.maximum(carries[body], carries[model.body_parentid[body]])
        self.carried = carries[model.geom_bodyid]  # geoms x joints: 1 where the joint moves the geom
        self.moves = self.carried.any(axis=1)
        names = [model.body(body).name for body in model.geom_bodyid]
        hand = np.array([any(name.startswith(robot.gripper_prefix) for robot in robots) for name in names])
        table = np.array([name == "table" for name in names])
        self.kept = np.where(hand[:, None] & table | table[:, None] & hand, NEAR_MARGIN, MARGIN)
        collides = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
        self.shapes = np.flatnonzero(self.moves & collides)
        self._carried, self._rbound = self.carried[self.shapes], model.geom_rbound[self.shapes, None] + SEEN
        self._stays = 1.0 - self._carried
        self._number = np.full(model.ngeom, len(self.shapes))  # what stands still comes last
        self._number[self.shapes] = np.arange(len(self.shapes))
        self._threshold = np.where(collides, SEEN, 0.0)
        self._capsules = np.flatnonzero(collides & (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE))
        self._boxes = np.flatnonzero(collides & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX))
        root = model.body_rootid[model.geom_bodyid]
        self._may_touch = root[self._boxes, None] != root[self._capsules]  # of one robot, boxes are in its links

    def look(self, q: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the pairs of geoms that are near at joints, and their distances [m]."""
        model, data = self.model, self.data
        data.qpos[self.address] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        contact = data.contact
        geoms, distance = contact.geom, contact.dist
        counts = self.moves[geoms[:, 0]] | self.moves[geoms[:, 1]]
        return geoms[counts], distance[counts]

    def at(self, q: NDArray[np.float64]) -> float:
        """Return the least distance beyond what is to be kept [m]."""
        geoms, distance = self.look(q)
        return float((distance - self.kept[geoms[:, 0], geoms[:, 1]]).min(initial=SEEN))

    def is_pierced(self) -> bool:
        """Return True if the axis of a capsule passes through a box where the model is: MuJoCo sees no contact then."""
        data, model = self.data, self.model
        away = data.geom_xpos[self._boxes, None] - data.geom_xpos[self._capsules]
        reach = model.geom_rbound[self._boxes, None] + model.geom_rbound[self._capsules]
        i, j = np.nonzero(self._may_touch & (np.einsum("bci,bci->bc", away, away) < reach**2))
        box, capsule = self._boxes[i], self._capsules[j]
        turn = data.geom_xmat[box].reshape(-1, 3, 3)
        axis = data.geom_xmat[capsule, 2::3] * model.geom_size[capsule, 1:2]
        middle = np.einsum("pij,pi->pj", turn, data.geom_xpos[capsule] - data.geom_xpos[box])
        along = np.einsum("pij,pi->pj", turn, axis)
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        half = model.geom_size[box]
        ends = np.sort([(-half - middle) / along, (half - middle) / along], axis=0)
        return bool((np.maximum(ends[0].max(axis=-1), -1.0) <= np.minimum(ends[1].min(axis=-1), 1.0)).any())

    def __enter__(self) -> Judge:
        """Have contacts reported from a distance on."""
        self._margins = self.model.geom_margin.copy(), self.model.body_margin.copy()
        self.model.geom_margin[:] = self._threshold
        self.model.body_margin[:] = SEEN
        return self

    def __exit__(self, *error: object) -> None:
        """Put the model back as it was."""
        self.model.geom_margin[:], self.model.body_margin[:] = self._margins

    def approach(self, way: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Return how much pairs of `shapes` approach on a way at most [m], the last being what stands still.

        And for which share of the way that holds: until something has moved by `SEEN`.
        """
        data = self.data
        (ax, ay, az), (px, py, pz) = data.xaxis[self.joints].T, data.xanchor[self.joints].T
        x, y, z = (data.geom_xpos[self.shapes, i, None] - anchor for i, anchor in enumerate((px, py, pz)))
        arm = np.sqrt((y * az - z * ay) ** 2 + (z * ax - x * az) ** 2 + (x * ay - y * ax) ** 2)  # from the axis
        speed = (arm + self._rbound) * self._carried * np.abs(way)
        count, whole = len(self.shapes), speed.sum(axis=1)
        pairs = np.zeros((count + 1, count + 1))
        between = speed @ self._stays.T
        pairs[:count, :count] = between + between.T
        pairs[count, :count] = pairs[:count, count] = whole
        return pairs, SEEN / (whole.max() + 1e-12)

    def is_apart(self, q: NDArray[np.float64], geoms: NDArray[np.int32]) -> bool:
        """Return True if pairs of geoms are apart at joints, by `mj_geomDistance`.

        `mj_collision` has no contact for some cylinders that are deep in a capsule, and has one again farther out.
        """
        self.data.qpos[self.address] = q
        mujoco.mj_kinematics(self.model, self.data)
        line = np.zeros(6)
        return all(mujoco.mj_geomDistance(self.model, self.data, *pair, SEEN, line) > 1e-3 for pair in geoms.tolist())

    def way(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> tuple[NDArray[np.int32], float]:
        """Return which geoms first touch on a way, and the least distance beyond what is to be kept [m]."""
        least, share, until = SEEN, 0.0, -1.0
        pairs = np.zeros((0, 0))
        while True:
            geoms, distance = self.look(start + share * (goal - start))
            kept = self.kept[geoms[:, 0], geoms[:, 1]]
            least = min(least, float((distance - kept).min(initial=SEEN)))
            touching = geoms[distance < 0.0]
            if len(touching) or share == 1.0:
                return touching, least
            # A pair that is not free any more can only come into contact.
            free = np.maximum(distance - kept if least >= SAMPLING else distance, SAMPLING)
            numbers = self._number[geoms]
            for is_new in (False, True):
                if is_new:
                    pairs, valid = self.approach(goal - start)
                    until = share + valid
                elif until <= share:
                    continue
                stride = (SEEN - MARGIN) / (pairs.max() + 1e-12)
                stride = min(stride, float((free / (pairs[numbers[:, 0], numbers[:, 1]] + 1e-12)).min(initial=1.0)))
                if share + stride <= until:
                    break
            share = min(share + stride, until, 1.0)


def draw(random: np.random.Generator, judge: Judge) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw a motion and place the obstacles."""
    data = judge.data
    start = random.uniform(judge.lower, judge.upper)
    way = random.normal(size=len(start))
    goal = start + way / np.abs(way).max() * np.exp(random.uniform(*np.log(WAY)))
    goal = np.clip(goal, judge.lower, judge.upper)
    data.mocap_pos[:BOXES] = random.uniform((-0.3, -0.7, 0.05), (0.7, 0.7, 0.9), (BOXES, 3))
    data.mocap_pos[BOXES] = 3.0
    has_plate, has_box = random.random(2) < (1 / 2, 1 / 3)
    if not has_plate and not has_box:
        return start, goal
    places = []
    for q in (start, goal, (start + goal) / 2):
        data.qpos[judge.address] = q
        mujoco.mj_kinematics(judge.model, data)
        places.append(data.geom_xpos[judge.shapes])
    moved = np.linalg.norm(places[1] - places[0], axis=1)
    odds = moved / judge.model.geom_rbound[judge.shapes]  # small shapes that go far
    one, other = random.choice(len(moved), 2, p=odds / odds.sum())
    if has_plate:
        data.mocap_pos[BOXES] = places[2][one]
        mujoco.mju_quatZ2Vec(data.mocap_quat[BOXES], (places[1] - places[0])[one] / moved[one])
    if has_box:
        ahead = (places[1] - places[0])[other] / moved[other]
        data.mocap_pos[0] = places[1][other] + random.uniform(0.0, 0.2) * ahead + random.normal(0.0, 0.04, 3)
    return start, goal


def measure(robot: str, motions: int, seed: int) -> dict[str, Any]:
    """Return the counts and times of one share of the motions."""
    guard = Guard(margin=MARGIN, near_margin=NEAR_MARGIN, touch=())
    env = rcs.make(Obstacles, robot=robot, stepping="sync", gates=[guard])
    env.reset(seed=seed)
    world, random, judge = env.simulation.world, np.random.default_rng(seed), Judge(env)
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
            start, goal = draw(random, judge)
            if judge.at(start) < 1e-3 or judge.is_pierced():  # begins too near
                continue
            touching, least = judge.way(start, goal)
            touches = len(touching) > 0
            if not judge.is_apart(start, touching):  # began in contact
                continue
            kind = "colliding" if touches else "free" if least >= SAMPLING else ""
            if not kind or counts[kind] >= motions:
                continue
            counts[kind] += 1
            counts["thin"] += touches and judge.at(goal) > 0.0
        for robot, joints in zip(env.simulation.robots, np.split(start, len(names)), strict=True):
            robot.put(joints, opening)
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
