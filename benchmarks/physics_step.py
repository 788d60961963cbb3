"""Effects of a longer time step of the physics: experts, grips, impacts, and how arms move.

    python benchmarks/physics_step.py                                        # an hour on one core
    python benchmarks/physics_step.py --steps 0.002 0.004 --robots fr3 --tasks Place:fr3

For each step, the experts make episodes of the same seeds. For each robot, the hand then holds the cuboid of
PickCuboid: `grip` is the mean force of a pad over a second [N], `sunk` how deep pad and cuboid overlap [mm], `slip` how
far the cuboid moves in the hand per minute [mm], and `swing` how far it is from where it comes to rest, from the end of
a fast turn of the base on [mm]. `impact` is the peak force of an open hand that comes down on the table at 0.1 and
0.25 m/s [N]; `overshoot` [degrees], `settling` [s], `behind` and `beside` [mm] are those of `motion.py`, and `fall_mm`
is how deep a cuboid that falls by 30 cm sinks into the table. `cpu` is the time of a processor that a simulated second
of the expert takes [s].

Prints a table of both kinds, then one JSON object: a row per task and step in `experts`, per robot and step in
`robots`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import tyro
from impact import hit
from motion import Log, line, make, steps
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.tasks.pick_cuboid import CUBOID

EFFECTORS: dict[str, dict[str, Any]] = {"xarm7": {"end_effector": "robotiq_2f85"}}
"""The hand of a robot, where the usual one has no pads."""
IMPACTS = (0.1, 0.25)
"""Speeds of the hand on its way down [m/s]."""
PICK, SETTLED, MINUTE, REST, TURN = 8.0, 2.0, 60.0, 1.0, 0.3
"""How long the expert has for the cuboid, until it rests, how long it is then held, and forces are averaged [s]; the
turn of the base [rad]."""


@dataclass(kw_only=True)
class Options:
    """The measurements to make."""

    steps: tuple[float, ...] = (0.002, 0.0025, 0.003, 0.004, 0.005)
    """Time steps of the physics [s]."""
    tasks: tuple[str, ...] = (
        *(f"PickCuboid:{robot}" for robot in ("fr3", "ur5e", "xarm7", "so101")),
        *("Place:fr3", "Place:so101", "StackCuboid:fr3", "Push:fr3", "PickToy:xarm7", "LiftBar:dual_fr3"),
    )
    """Tasks of the experts, with the robot of each."""
    episodes: int = 100
    """Episodes of each task."""
    robots: tuple[str, ...] = ("fr3", "ur5e", "xarm7", "so101")
    """Robots whose grips, impacts and motions are measured."""


def expert(name: str, physics_step: float, episodes: int) -> dict[str, Any]:
    """Return how many episodes of a task succeed, and what they take."""
    task, robot = name.split(":")
    successes, simulated, used = 0, 0.0, 0.0
    with rcs.make(task, robot=robot, physics_step=physics_step, **EFFECTORS.get(robot, {})) as env:
        agent = agent_for(env)
        for seed in range(episodes):
            observation, info = env.reset(seed=seed)
            agent.reset(observation, info)
            is_over, began, before = False, float(info["time"]), time.process_time()
            while not is_over:
                observation, _, terminated, truncated, info = env.step(agent.act(observation, info))
                is_over = terminated or truncated
            used += time.process_time() - before
            simulated += float(info["time"]) - began
            successes += bool(info["success"])
    times = {"seconds": round(simulated / episodes, 2), "cpu": round(used / simulated, 4)}
    return {"physics_step": physics_step, "task": name, "successes": successes, "episodes": episodes, **times}


class Held:
    """A robot that holds the cuboid, and goes on holding it."""

    def __init__(self, robot: str, physics_step: float) -> None:
        """Pick the cuboid up, and wait until everything rests."""
        form: dict[str, Any] = {"control": "joints", "relative": "absolute", "max_episode_steps": None}
        form["task_options"] = {"hold_time": 10 * MINUTE}  # the episode does not end
        form |= EFFECTORS.get(robot, {})
        self.env = rcs.make("PickCuboid", robot=robot, physics_step=physics_step, **form)
        world, placement = self.env.simulation.world, self.env.simulation.robots[0].placement
        assert placement.gripper is not None and world.data is not None
        self.data, self._model = world.data, world.model
        pads = [[placement.gripper_prefix + pad for pad in finger] for finger in placement.gripper.pad_geoms]
        cuboid = world.geom_flags([CUBOID])
        self._forces = [world.core.read_force(world.geom_flags(finger), cuboid) for finger in pads]
        self._pads = [world.model.geom(pad).id for finger in pads for pad in finger]
        self._hand = world.model.body(placement.gripper_prefix + placement.gripper.base_body).id
        self._box, self._geom = world.model.body(CUBOID).id, world.model.geom(CUBOID).id
        agent = agent_for(self.env)
        observation, info = self.env.reset(seed=0)
        agent.reset(observation, info)
        for _ in range(round(PICK * self.env.frequency)):
            self.action = agent.act(observation, info)
            observation, *_, info = self.env.step(self.action)
        assert info["is_grasped"], f"{robot} lost the cuboid with a physics step of {physics_step} s"
        self.wait(SETTLED)

    def wait(self, seconds: float) -> list[list[float]]:
        """Go on holding; return the forces of the pads at the ends of the steps [N]."""
        rows: list[list[float]] = []
        for _ in range(round(seconds * self.env.frequency)):
            self.env.step(self.action)
            rows.append([float(self.env.simulation.world.forces[force]) for force in self._forces])
        return rows

    def sunk(self) -> float:
        """Return how deep the cuboid and a pad overlap [m]."""
        contacts = self.data.contact
        with_cuboid = (contacts.geom == self._geom).any(axis=1) & np.isin(contacts.geom, self._pads).any(axis=1)
        return -float(contacts.dist[with_cuboid].min(initial=0.0))

    def in_hand(self) -> NDArray[np.float64]:
        """Return where the cuboid is in the frame of the hand [m]."""
        axes = self.data.xmat[self._hand].reshape(3, 3)
        return axes.T @ (self.data.xpos[self._box] - self.data.xpos[self._hand])

    def swing(self) -> float:
        """Turn the base fast; return how far the cuboid then is from where it comes to rest, at most [m]."""
        motion, places = self.env.simulation.robots[0].motion, list[tuple[bool, NDArray[np.float64]]]()

        def note(view: Any) -> None:
            places.append((bool(np.any(motion.state(view)[1:])), view.xpos[self._box].copy()))

        self.env.simulation.world.on_period(note, self._model.opt.timestep)
        self.action = {**self.action, "joints": self.action["joints"] + np.eye(len(self.action["joints"]))[0] * TURN}
        self.wait(REST + SETTLED)
        ended = len(places) - next(i for i, (led, _) in enumerate(reversed(places)) if led)
        return float(np.linalg.norm(np.array([place for _, place in places[ended:]]) - places[-1][1], axis=1).max())


def fall(physics_step: float) -> float:
    """Return how deep a cuboid that falls sinks into the table at most [mm]."""
    deepest = 0.0
    with rcs.make("PickCuboid", physics_step=physics_step) as env:
        world = env.simulation.world
        model, data = world.model, world.data
        assert data is not None
        for height in np.linspace(
            0.29, 0.31, 11
        ):  # it matters where the cuboid is in the step in which it touches the table
            env.reset(seed=0)
            data.qpos[model.jnt_qposadr[model.body(CUBOID).jntadr[0]] + 2] += height
            for _ in range(round(0.5 / physics_step)):
                mujoco.mj_step(model, data)
                of_cuboid = (data.contact.geom == model.geom(CUBOID).id).any(axis=1)
                deepest = max(deepest, -float(data.contact.dist[of_cuboid].min(initial=0.0)))
    return 1e3 * deepest


def robot_row(robot: str, physics_step: float) -> dict[str, Any]:
    """Return how a robot holds the cuboid, hits the table, and moves."""
    held, effector = Held(robot, physics_step), EFFECTORS.get(robot, {})
    found = {"grip": float(np.mean(held.wait(REST))), "sunk": 1e3 * held.sunk()}
    place = held.in_hand()
    held.wait(MINUTE)
    found |= {"slip": 1e3 * float(np.linalg.norm(held.in_hand() - place)), "swing": 1e3 * held.swing()}
    held.env.close()
    for speed in IMPACTS:
        found[f"impact_{speed:g}"] = float(hit(robot, speed, physics_step, **effector)["peak_force"])
    env = make(robot, "async", control="joints", physics_step=physics_step, **effector)
    moved = steps(env, Log(env))
    env.close()
    found |= {"overshoot": moved["overshoot_deg"], "settling": moved["settling_s"]}
    along = line(robot, physics_step=physics_step, **effector)
    found |= {key.removesuffix("_mm"): value for key, value in along.items()}
    return {"physics_step": physics_step, "robot": robot} | {key: round(value, 4) for key, value in found.items()}


def shown(rows: Iterator[dict[str, Any]]) -> list[dict[str, Any]]:
    """Print the rows of a table as they come, and return them."""
    found: list[dict[str, Any]] = []
    for row in rows:
        if not found:
            print("| " + " | ".join(row) + " |\n" + "|---" * len(row) + "|")
        print("| " + " | ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in row.values()) + " |", flush=True)
        found.append(row)
    return found


def main(options: Options) -> None:
    """Measure and print."""
    robots = shown(robot_row(robot, step) for robot in options.robots for step in options.steps)
    experts = shown(expert(name, step, options.episodes) for name in options.tasks for step in options.steps)
    falls = {f"{step:g}": round(fall(step), 2) for step in options.steps}
    print(json.dumps({"benchmark": "physics_step", "experts": experts, "robots": robots, "fall_mm": falls}))


if __name__ == "__main__":
    main(tyro.cli(Options))
