"""Ways of an arm between joints and what a guard admits of them, and a cuboid lifted above a plate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

import rcs
from rcs.agents import agent_for
from rcs.envs import Env
from rcs.robots.fr3 import FR3
from rcs.sim import Scene
from rcs.tasks.pick_cuboid import PickCuboid

OPEN = np.ones(1, np.float32)
HOME = np.array(FR3.home)
DOWN = np.array([0, 1.3, 0, -0.35, 0, 0.95, 0])
"""From home through the table, the fingers first [rad]."""


def ask(env: Env, start: Any, goal: Any) -> Mapping[str, Any]:
    """Return what the guard admits of a way between joints."""
    guard: Any = env.stack.gates[0]
    env.simulation.robots[0].put(np.array(start))
    measured = {"": {"joints": np.array(start), "gripper": OPEN}}
    guard.reset(measured, ...)
    return guard.admit({"": {"joints": np.array(goal), "gripper": OPEN}}, measured)


class PickBesidePlate(PickCuboid):
    """The task of picking, and a plate that can be put anywhere."""

    def furnish(self, scene: Scene) -> None:
        super().furnish(scene)
        plate = scene.spec.worldbody.add_body(name="plate", mocap=True, pos=(0.0, 5.0, 0.0))
        plate.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.15, 0.15, 0.001))


def make_beside_plate(task_options: Mapping[str, Any] | None = None, **gates: Any) -> Env:
    """Return an environment with the plate and a guard with some options."""
    options: dict[str, Any] = {"control": "tquat", "relative": False, "max_episode_steps": None}
    options["task_options"] = dict(task_options or {})
    return rcs.make(PickBesidePlate, gates={"Guard": gates}, **options)


def lift_above_plate(env: Env) -> dict[str, Any]:
    """Have the cuboid lifted, and put the plate 30 mm below it; return the action that stays."""
    agent = agent_for(env, None)
    observation, info = env.reset(seed=0)
    agent.reset(observation, info)
    for _ in range(200):
        observation, *_, info = env.step(agent.act(observation, info))
        if info["is_grasped"] and info["cuboid"][2] > 0.12:
            break
    assert info["is_grasped"]
    target = {"tquat": observation["tquat"].copy(), "gripper": np.zeros(1, np.float32)}
    for _ in range(20):
        *_, info = env.step(target)
    world, cuboid = env.simulation.world, env.simulation.world.data.body("cuboid")
    # Below the cuboid, which reaches lower than the fingers.
    bottom = cuboid.xpos[2] - 0.5 * info["edges"][2]
    world.data.mocap_pos[0] = (cuboid.xpos[0], cuboid.xpos[1], bottom - 0.03)
    return target
