"""Count the contacts of arms that are led to far goals under a guard, and its false stops, in every physics step.

N episodes per setup and mode of asynchronous steps at 30 Hz towards random joints in the whole range, the first from
rest, the next after 3 to 30 steps and so in motion. The judge is MuJoCo: every contact of a robot in every physics step
counts, but for those of the task's object and of one gripper with itself. A first refusal of an episode is a false stop
when the requested step, executed without a guard, with the arms held after it, keeps all distances and 2 mm in every
physics step. Prints one JSON object per setup and mode: `touching` (episodes with a contact),
`worst_force_n` (the largest normal force of such a contact), `stopped` (episodes in which the guard intervened),
`false_stops` (part of all decisions), `p99_ms` and `p50_ms` (time of a decision), `episodes`, `decisions`.
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
from guard import MARGIN, NEAR_MARGIN, SAMPLING, SEEN, Judge
from numpy.typing import NDArray

import rcs
from rcs.envs import Guard


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: tuple[str, ...] = ("fr3", "dual_fr3", "ur5e", "so101")
    """Robots whose streams are executed."""
    episodes: int = 2000
    """Episodes per setup and mode."""
    seed: int = 0
    """Random seed of the goals."""
    workers: int = 1
    """Processes that share the episodes; more disturb the times."""


STREAMS = (("Free", "dual_fr3"), ("PickCuboid", "fr3"), ("PickCuboid", "ur5e"), ("PickCuboid", "so101"))
"""Tasks and robots whose streams are executed."""
STEPS = 45
"""Steps of an episode."""


class Witness:
    """Sees every contact that a robot has in any physics step, and how near it comes when that is asked for."""

    def __init__(self, env: rcs.envs.Env) -> None:
        world = env.simulation.world
        self.judge, self._data, self._model = Judge(env), world.data, world.model
        names = [self._model.body(body).name for body in self._model.geom_bodyid]
        objects = env.simulation.task.objects()
        self._is_object = np.array([name in objects for name in names])
        hands = [robot.gripper_prefix for robot in env.robots.values()]
        self._hand = np.array(
            [next((k for k, own in enumerate(hands, 1) if name.startswith(own)), 0) for name in names]
        )
        self.force, self.least, self.is_measuring = 0.0, np.inf, False
        world.on_period(self.see, float(self._model.opt.timestep))

    def counts(self, geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which pairs of geoms must not touch."""
        a, b = geoms.T
        is_robot = self.judge.moves[a] | self.judge.moves[b]
        is_own_hand = (self._hand[a] > 0) & (self._hand[a] == self._hand[b])
        return is_robot & ~is_own_hand & ~self._is_object[a] & ~self._is_object[b]

    def see(self, _: Any) -> bool:
        """Note the contacts of a physics step."""
        if self.is_measuring:
            self.judge.data.qpos[:] = self._data.qpos
            with self.judge:
                geoms, distance = self.judge.look(self._data.qpos[self.judge.address])
            keep = self.counts(geoms)
            beyond = distance[keep] - self.judge.kept[geoms[keep, 0], geoms[keep, 1]]
            self.least = min(self.least, float(beyond.min(initial=SEEN)))
            return False
        contact = self._data.contact
        for number in np.flatnonzero(self.counts(contact.geom) & (contact.dist < 0.0)).tolist():
            force = np.zeros(6)
            mujoco.mj_contactForce(self._model, self._data, number, force)
            self.force = max(self.force, float(force[0]), 1e-9)
        return False

    def would_keep_apart(self, env: rcs.envs.Env, asked: list[NDArray[np.float64]]) -> bool:
        """Return True if a step that was refused, executed, would have kept all distances and `SAMPLING`."""
        core, robots = env.simulation.world.core, env.simulation.robots
        saved = core.save(0)
        self.least, self.is_measuring = np.inf, True
        for robot, joints in zip(robots, asked, strict=True):
            robot.command_joints(joints)
        core.advance()
        for robot in robots:
            robot.stop()
        for _ in range(20):
            core.advance()
        self.is_measuring = False
        core.load(saved)
        return self.least >= SAMPLING


class Timed(Guard):
    """A guard that notes how long it takes, and what it refused first."""

    times: list[float]
    refused: list[NDArray[np.float64]] | None = None
    is_false = False
    witness: Witness | None = None
    env: rcs.envs.Env

    def admit(self, targets: Any, measured: Any) -> Any:
        """Admit as the guard does."""
        began = time.perf_counter()
        admitted: Any = None
        try:
            admitted = super().admit(targets, measured)
            return admitted
        finally:
            self.times.append(time.perf_counter() - began)
            if admitted is not targets and self.refused is None:
                self.refused = [np.array(own["joints"]) for own in targets.values() if "joints" in own]
                self.is_false = self.witness is not None and self.witness.would_keep_apart(self.env, self.refused)


def stream(task: str, robot: str, mode: Any, episodes: range) -> dict[str, Any]:
    """Execute episodes; return the counts and times."""
    guard = Timed(on_hit=mode, margin=MARGIN, near_margin=NEAR_MARGIN)
    guard.times = []
    env = rcs.make(task, robot=robot, relative="absolute", gates=[guard], max_episode_steps=None)
    guard.env, guard.witness = env, Witness(env)
    found: dict[str, Any] = {"touching": 0, "stopped": 0, "false": 0, "force": 0.0}
    names = list(env.robots) if len(env.robots) > 1 else [""]
    judge = guard.witness.judge
    for episode in episodes:
        random = np.random.default_rng((episode, 7))
        env.reset(seed=episode)
        guard.refused, guard.is_false, guard.witness.force = None, False, 0.0
        left = 0
        for _ in range(STEPS):
            if left == 0:
                goal = np.split(random.uniform(judge.lower, judge.upper), len(names))
                left = int(random.integers(3, 31))
            left -= 1
            action: Any = {
                name: {"joints": own, "gripper": np.ones(1, np.float32)} for name, own in zip(names, goal, strict=True)
            }
            *_, truncated, _ = env.step(action[""] if names == [""] else action)
            if truncated:  # a collision
                break
        found["touching"] += guard.witness.force > 0.0
        found["force"] = max(found["force"], guard.witness.force)
        found["stopped"] += guard.refused is not None
        found["false"] += guard.is_false
    env.close()
    return {**found, "times": guard.times}


def main(options: Options) -> None:
    """Execute streams in all setups and modes, and print."""
    for task, robot in STREAMS:
        if robot not in options.robot:
            continue
        for mode in ("reject", "clip"):
            first, count = options.seed * options.episodes, options.workers
            shares = [range(first + k, first + options.episodes, count) for k in range(count)]
            with ProcessPoolExecutor(count, mp_context=get_context("fork")) as pool:
                found = list(pool.map(stream, [task] * count, [robot] * count, [mode] * count, shares))
            times = 1e3 * np.concatenate([one["times"] for one in found])
            figures = {
                "benchmark": "guard streams",
                "robot": robot,
                "task": task,
                "mode": mode,
                "touching": sum(one["touching"] for one in found),
                "worst_force_n": round(max(one["force"] for one in found), 2),
                "stopped": sum(one["stopped"] for one in found),
                "false_stops": round(sum(one["false"] for one in found) / len(times), 5),
                "p99_ms": round(float(np.quantile(times, 0.99)), 3),
                "p50_ms": round(float(np.median(times)), 3),
                "episodes": options.episodes,
                "decisions": len(times),
            }
            print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
